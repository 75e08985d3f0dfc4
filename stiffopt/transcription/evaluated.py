"""Functions of points as they are evaluated: by the interpreter of batched instructions.

CasADi's own evaluation, of one point a call, takes its place where there is no compiled core.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

import casadi as ca

from stiffopt import native
from stiffopt.interpreter.batched import batched
from stiffopt.transcription.node_derivatives import NumberedStage

# Inputs of a numbered stage that are the same at all points: parameters and numbers.
_SHARED = (1, 2)
# Functions kept for another mesh or the next problem of the same formula.
MAX_KEPT = 16

_kept: OrderedDict[str, tuple[ca.Function, ...]] = OrderedDict()


def stage_functions(stage: NumberedStage) -> tuple[ca.Function, ...]:
    """Return a stage's values, Jacobian and Hessian, of one point or several side by side."""
    return _once(stage.formula, lambda: stage.derivatives)


def point_function(function: ca.Function) -> ca.Function:
    """Return a function (w, p, numbers) -> values, of one point or several side by side."""
    return _once(function.serialize(), lambda: (function,))[0]


def _once(key: str, functions: Callable[[], tuple[ca.Function, ...]]) -> tuple[ca.Function, ...]:
    path = native.library()
    key = f"{path} {key}"
    if key not in _kept:
        made = functions()
        # An iteration of the optimiser asks for values and slopes again and again.
        _kept[key] = (
            made
            if path is None
            else tuple(
                batched(path, each, _SHARED, recalled=len(made) > 1 and k < 2) or each
                for k, each in enumerate(made)
            )
        )
    _kept.move_to_end(key)
    while len(_kept) > MAX_KEPT:
        _kept.popitem(last=False)
    return _kept[key]
