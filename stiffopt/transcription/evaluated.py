"""Functions of points as they are evaluated: by the interpreter of batched instructions.

CasADi's own evaluation, of one point a call, takes its place where there is no compiled core.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import casadi as ca

from stiffopt import native
from stiffopt.interpreter.batched import batched
from stiffopt.transcription.node_derivatives import NumberedStage

# Inputs of a numbered stage that are the same at all points: parameters and numbers.
_SHARED_INPUTS = (1, 2)
# Functions kept for another mesh or the next problem of the same formula.
MAX_KEPT = 16

_kept_functions: OrderedDict[tuple[str, Path | None], tuple[ca.Function, ...]] = OrderedDict()


def stage_functions(stage: NumberedStage) -> tuple[ca.Function, ...]:
    """Return a stage's values, Jacobian and Hessian, of one point or several side by side."""
    return _prepare_once(stage.formula, lambda: stage.derivatives)


def point_function(function: ca.Function) -> ca.Function:
    """Return a function (w, p, numbers) -> values, of one point or several side by side."""
    formula = hashlib.sha256(function.serialize().encode()).hexdigest()
    return _prepare_once(formula, lambda: (function,))[0]


def _prepare_once(
    formula: str, functions: Callable[[], tuple[ca.Function, ...]]
) -> tuple[ca.Function, ...]:
    path = native.library()
    key = (formula, path)
    if key not in _kept_functions:
        found = functions()
        if path is not None:
            # An iteration of the optimiser asks for values and slopes again and again.
            several = [
                batched(path, each, _SHARED_INPUTS, recalled=len(found) > 1 and k < 2)
                for k, each in enumerate(found)
            ]
            # All of one stage are of as many points.
            if None not in several:
                found = tuple(each for each in several if each is not None)
        _kept_functions[key] = found
    _kept_functions.move_to_end(key)
    while len(_kept_functions) > MAX_KEPT:
        _kept_functions.popitem(last=False)
    return _kept_functions[key]
