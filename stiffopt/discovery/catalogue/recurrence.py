"""Recurrences over samples, differentiable by CasADi, for effects with memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dtbtrs

from stiffopt.symbolic import Quantity, array_of, is_symbolic

# (state, inputs of one sample, parameters) -> (next state, output), in NumPy style.
Step = Callable[[Quantity, Sequence[Quantity], Sequence[Quantity]], tuple[Quantity, Quantity]]


def recurrence_output(
    step: Step,
    inputs: Sequence[Quantity],
    state: Sequence[Quantity],
    parameters: Sequence[Quantity] = (),
) -> Quantity:
    """Return the output of a recurrence at every sample, in the shape of a term.

    Parameters
    ----------
    step : callable
        As in `scan`.
    inputs : sequence of array (K,) or SX (K, 1)
        Symbols are unrolled sample by sample, which suits short stretches.
    state : sequence of float or SX
        Before the first sample.
    parameters : sequence of float or SX or MX

    Returns
    -------
    array (K,) or symbol (K, 1)
    """
    if any(is_symbolic(u) for u in (*inputs, *state)):
        return _unroll_recurrence(step, inputs, state, parameters)
    output = scan(step, inputs, [float(x) for x in state], parameters)
    return output.T if is_symbolic(output) else output


def first_order_lag(values: Quantity, kept: Quantity) -> Quantity:
    """Return the first-order lag of a signal (K,); a step keeps the share `kept`."""
    if is_symbolic(values) or is_symbolic(kept):
        return recurrence_output(_lag_step, [values], [values[0]], [kept])
    added = (1.0 - kept) * values
    added[0] = values[0]
    return linear_recurrence(np.full(len(added), float(kept)), added)


def linear_recurrence(kept: np.ndarray, added: np.ndarray) -> np.ndarray:
    """Return x_k = kept_k x_k-1 + added_k (K,) from added_0 on, by bidiagonal equations."""
    band = np.ones((2, len(kept)))
    band[1, :-1] = -kept[1:]
    return np.asarray(dtbtrs(band, added, uplo="L", diag="U")[0])


def _lag_step(
    state: Quantity, inputs: Sequence[Quantity], parameters: Sequence[Quantity]
) -> tuple[Quantity, Quantity]:
    now = inputs[0] + (state[0] - inputs[0]) * parameters[0]
    return now, now


def _unroll_recurrence(
    step: Step, inputs: Sequence[Quantity], state: Quantity, parameters: Sequence[Quantity]
) -> Quantity:
    now, outputs = ca.vertcat(*state), []
    for k in range(inputs[0].shape[0]):
        now, output = step(now, [u[k] for u in inputs], parameters)
        outputs.append(output)
    return ca.vertcat(*outputs)


def scan(
    step: Step,
    inputs: Sequence[Quantity],
    state: Sequence[float],
    parameters: Sequence[Quantity] = (),
) -> Quantity:
    """Return the output of a recurrence for every sample.

    Parameters
    ----------
    step : callable
        (state (m,), inputs, parameters) -> (next state (m,), output); works on CasADi symbols. A
        module-level function, so that its symbolic form is kept.
    inputs : sequence of array (K,)
    state : sequence of float
        At the first sample (m,).
    parameters : sequence of float or SX or MX

    Returns
    -------
    array (K,), or MX (1, K) where a parameter is symbolic
    """
    count = len(np.asarray(inputs[0]).ravel())
    mapped = _compile_scan(step, len(state), len(inputs), len(parameters), count)
    samples = np.vstack([np.asarray(u, dtype=float).ravel() for u in inputs])
    symbolic = any(is_symbolic(p) for p in parameters)
    own: Any
    if symbolic:
        own = ca.repmat(ca.vertcat(*parameters), 1, count)
    else:
        own = np.tile(np.array(parameters, dtype=float)[:, None], count)
    _, output = mapped(ca.DM(list(state)), samples, own)
    return output if symbolic else array_of(output).ravel()


@lru_cache(maxsize=64)
def _compile_scan(step: Step, states: int, inputs: int, parameters: int, count: int) -> Any:
    x = ca.SX.sym("x", states)
    u = ca.SX.sym("u", inputs)
    p = ca.SX.sym("p", parameters)
    following, output = step(x, [u[i] for i in range(inputs)], [p[i] for i in range(parameters)])
    function = ca.Function("step", [x, u, p], [following, output])
    return function.mapaccum("scan", count)
