"""A CasADi function as one of `POINTS` points a call, evaluated by interpreter.c.

A function of a hundred thousand operations is numbers that a few dozen loops read: each loop is one
computation, of other places of a work vector every time, for all points.
"""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np

# Points of a call, as interpreter.c is compiled for them.
POINTS = 16
# Sums, whose kinds are more than their operations.
_SUM_OPERATIONS = (ca.OP_ADD, ca.OP_SUB)

_DoublePointer, _IntPointer = ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_int)


class _Operations(ctypes.Structure):
    """A function's operations; see preparation.c."""

    _fields_ = (
        ("count", ctypes.c_longlong),
        ("places", ctypes.c_longlong),
        *((name, _IntPointer) for name in ("operation", "first", "second", "written")),
        ("numbers", _DoublePointer),
        ("kinds", _IntPointer),
        *(
            (n, ctypes.c_int)
            for n in ("input", "output", "constant", "add", "subtract", "multiply")
        ),
    )


class Batch(NamedTuple):
    """A function's operations as arrays, which are read once and loaded in any process."""

    # Numbers of inputs and outputs, 1 to recall the last calls, and places of the work vector.
    shape: np.ndarray
    sides: np.ndarray  # numbers of entries, and places in `sparsity`, as interpreter.c has them
    sparsity: np.ndarray
    operations: np.ndarray  # (4, count) operation, its two operands and where its result is written
    constants: np.ndarray  # of the operations that are constants, in their order

    def load(self, library: Path) -> ca.Function | None:
        """Return the function at `POINTS` points at once; None where too many are in use."""
        loaded, kinds = _load_library(library)
        operation = self.operations[0]
        if unknown := {int(each) for each in np.unique(operation) if kinds[each] < 0}:
            raise ValueError(f"no instruction for CasADi's operations {sorted(unknown)}")
        numbers = np.zeros(len(operation))
        numbers[operation == ca.OP_CONST] = self.constants
        given = _Operations(
            len(operation),
            int(self.shape[3]),
            *(each.ctypes.data_as(_IntPointer) for each in self.operations),
            numbers.ctypes.data_as(_DoublePointer),
            kinds.ctypes.data_as(_IntPointer),
            *(ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ADD, ca.OP_SUB, ca.OP_MUL),
        )
        slot = loaded.batch_load(
            ctypes.byref(given),
            self.shape[:3].ctypes.data_as(_IntPointer),
            self.sides.ctypes.data_as(_IntPointer),
            self.sparsity.ctypes.data_as(ctypes.POINTER(ctypes.c_longlong)),
            ctypes.c_longlong(len(self.sparsity)),
        )
        return None if slot < 0 else ca.external(f"batch_{slot:03x}", str(library))


def read_batch(
    function: ca.Function, shared: tuple[int, ...] = (), *, recalled: bool = False
) -> Batch:
    """Read a function for `POINTS` points at once.

    `function`: of SX. Inputs and outputs of the points stand side by side: (m, n) becomes
    (m, POINTS n). `shared`: inputs that are the same at all points. `recalled`: keep the outputs of
    the last calls, for functions of one output that are called with the same inputs again and
    again.
    """
    inputs, outputs = range(function.n_in()), range(function.n_out())
    widths = [function.nnz_in(i) * (i not in shared) for i in inputs]
    patterns = [_repeat_pattern(function.sparsity_in(i), i in shared) for i in inputs]
    patterns += [_repeat_pattern(function.sparsity_out(i), False) for i in outputs]
    compressed = [pattern.compress() for pattern in patterns]
    sides = [
        *widths,
        *(function.nnz_in(i) * (POINTS if width else 1) for i, width in enumerate(widths)),
        *(function.nnz_out(i) for i in outputs),
        *np.cumsum([0, *map(len, compressed)])[:-1],
    ]
    operations, constants = _read_operations(function)
    return Batch(
        np.array([len(inputs), len(outputs), recalled, function.sz_w()], dtype=np.int32),
        np.array(sides, dtype=np.int32),
        np.concatenate(compressed).astype(np.int64),
        operations,
        constants,
    )


def _read_operations(function: ca.Function) -> tuple[np.ndarray, np.ndarray]:
    count, constants, rows = function.n_instructions(), [], []
    read, written = function.instruction_input, function.instruction_output
    for k, each in enumerate(map(function.instruction_id, range(count))):
        row = (each, *read(k), *written(k))
        if len(row) == 3:
            row = (each, row[1], -1, row[2])
        elif each == ca.OP_CONST:
            row = (each, -1, -1, *written(k))
            constants.append(function.instruction_constant(k))
        rows.append(row)
    return np.array(rows, dtype=np.int32).reshape(count, 4).T.copy(), np.array(constants)


@functools.cache
def _load_library(library: Path) -> tuple[ctypes.CDLL, np.ndarray]:
    """The library, and the kinds of instructions by CasADi's operations; -1 where there is none."""
    loaded = ctypes.CDLL(str(library))
    numbers = {getattr(ca, name): name[3:] for name in dir(ca) if name.startswith("OP_")}
    kinds = np.full(max(numbers) + 1, -1, dtype=np.int32)
    known = kind_names(library)
    for number, name in numbers.items():
        if name in known:
            kinds[number] = known.index(name)
    # No instructions, or kinds of their own.
    kinds[[ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, *_SUM_OPERATIONS]] = 0
    return loaded, kinds


def kind_names(library: Path) -> list[str]:
    """Kinds of instructions: names of operations of CasADi without OP_, and sums of x0, x1, .."""
    kinds = ctypes.CDLL(str(library)).batch_kinds
    kinds.restype = ctypes.POINTER(ctypes.c_char_p)
    names: list[str] = []
    for name in kinds():
        if name is None:
            break
        names.append(name.decode())
    return names


def _repeat_pattern(sparsity: ca.Sparsity, same: bool) -> ca.Sparsity:
    return sparsity if same else ca.repmat(sparsity, 1, POINTS)
