"""CasADi conventions: formulas in plain NumPy serve floats, arrays, SX and MX.

CasADi 3.8 supports `np.exp(SX)` and the like; `setNumpyMode(-1)` makes the result type follow the
input and silences the warning. Import this module (not casadi) before evaluating a formula on
symbols.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy

ca.GlobalOptions.setNumpyMode(-1)

# Float, array, SX or MX: anything that np.* and arithmetic accept.
Quantity = Any


def is_symbolic(value: Quantity) -> bool:
    """Return True for SX and MX expressions."""
    return isinstance(value, ca.SX | ca.MX)


def array_of(matrix: ca.DM) -> np.ndarray:
    """Convert a matrix to an array.

    Unlike this, `DM.full()` runs Python code within C++, which loses a Ctrl-C and returns None.
    """
    dense = matrix if matrix.is_dense() else ca.densify(matrix)
    return np.array(dense.nonzeros(), dtype=float).reshape(matrix.shape, order="F")


class BufferedFunction:
    """CasADi function with preallocated buffers: calls create no matrices."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._buffer, self._evaluate = function.buffer()
        self._given = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self._found = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        # CasADi's annotations lack the overload that takes sizes from the memory view.
        set_given: Any = self._buffer.set_arg
        set_found: Any = self._buffer.set_res
        for i, given in enumerate(self._given):
            set_given(i, memoryview(given.data))
        for i, found in enumerate(self._found):
            set_found(i, memoryview(found.data))

    @cached_property
    def _sparsity_patterns(self) -> list[tuple[np.ndarray, np.ndarray, tuple[int, int]]]:
        patterns = [self.function.sparsity_out(i) for i in range(self.function.n_out())]
        return [(np.array(p.row()), np.array(p.colind()), p.shape) for p in patterns]

    def __call__(self, *given: np.ndarray | float) -> list[np.ndarray]:
        """Evaluate the nonzeros of all outputs; overwritten by the next call."""
        for own, value in zip(self._given, given, strict=True):
            own[:] = value
        self._evaluate()
        return self._found

    def sparse(self, output: int) -> scipy.sparse.csc_matrix:
        """Copy an output of the last call to a sparse matrix."""
        rows, starts, shape = self._sparsity_patterns[output]
        return scipy.sparse.csc_matrix((self._found[output].copy(), rows, starts), shape=shape)


def softplus(x: Quantity) -> Quantity:
    """Smooth max(x, 0) without overflow: log(1 + exp(x))."""
    return np.logaddexp(x, 0.0) if not is_symbolic(x) else _softplus_symbolic(x)


def _softplus_symbolic(x: Quantity) -> Quantity:
    # fmax(x, 0) + log1p(exp(-|x|)) is the stable form, C-infinity although its parts are not.
    return ca.fmax(x, 0) + ca.log1p(ca.exp(-ca.fabs(x)))


def smooth_abs(x: Quantity, width: Quantity) -> Quantity:
    """Smooth |x|: sqrt(x^2 + width^2)."""
    return np.sqrt(x * x + width * width)


def elementwise_derivative(
    formula: Callable[[Quantity], Quantity], x: Quantity, order: int = 1
) -> Quantity:
    """Derivative of an elementwise formula by CasADi, for floats, arrays, SX and MX alike."""
    if is_symbolic(x):
        symbol = type(x).sym("x", x.shape)
        value = formula(symbol)
        for _ in range(order):
            value = ca.jtimes(value, symbol, type(x).ones(*x.shape))
        return ca.substitute(value, symbol, x)
    symbol = ca.SX.sym("x")
    value = formula(symbol)
    for _ in range(order):
        value = ca.jacobian(value, symbol)
    function = ca.Function("derivative", [symbol], [ca.densify(value)])
    array = np.asarray(x, dtype=float)
    result = np.asarray(function(array.reshape(1, -1))).reshape(array.shape)
    return float(result) if array.ndim == 0 else result
