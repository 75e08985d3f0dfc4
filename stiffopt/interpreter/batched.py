"""A CasADi function as one of `POINTS` points a call, evaluated by interpreter.c.

A function of a hundred thousand operations is numbers that a few dozen loops read: each loop is one
computation, of other places of a work vector every time, for all points.
"""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

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


def batched(
    library: Path, function: ca.Function, shared: tuple[int, ...] = (), *, recalled: bool = False
) -> ca.Function | None:
    """The function at `POINTS` points at once.

    `library`: that interpreter.c is part of. `function`: of SX. Inputs and outputs of the points
    stand side by side: (m, n) becomes (m, POINTS n). `shared`: inputs that are the same at all
    points. `recalled`: keep the outputs of the last calls, for functions of one output that are
    called with the same inputs again and again. None where too many are in use.
    """
    loaded, kinds = _load_library(library)
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
    sparsity = np.concatenate(compressed).astype(np.int64)
    shape = np.array([len(inputs), len(outputs), recalled], dtype=np.int32)
    slot = loaded.batch_load(
        ctypes.byref(_read_operations(function, kinds)),
        shape.ctypes.data_as(_IntPointer),
        np.array(sides, dtype=np.int32).ctypes.data_as(_IntPointer),
        sparsity.ctypes.data_as(ctypes.POINTER(ctypes.c_longlong)),
        ctypes.c_longlong(len(sparsity)),
    )
    return None if slot < 0 else ca.external(f"batch_{slot:03x}", str(library))


def _read_operations(function: ca.Function, kinds: np.ndarray) -> _Operations:
    count = function.n_instructions()
    operation = [function.instruction_id(k) for k in range(count)]
    numbers, rows = np.zeros(count), []
    read, written = function.instruction_input, function.instruction_output
    for k, each in enumerate(operation):
        row = (*read(k), *written(k))
        if len(row) == 2:
            row = (row[0], -1, row[1])
        elif each == ca.OP_CONST:
            row, numbers[k] = (-1, -1, *row), function.instruction_constant(k)
        rows.append(row)
    first, second, places = np.array(rows, dtype=np.int32).reshape(count, 3).T.copy()
    if unknown := {each for each in operation if kinds[each] < 0}:
        raise ValueError(f"no instruction for CasADi's operations {sorted(unknown)}")
    arrays = (np.array(operation, dtype=np.int32), first, second, places, numbers, kinds)
    found = _Operations(
        count,
        function.sz_w(),
        *(
            each.ctypes.data_as(_DoublePointer if each is numbers else _IntPointer)
            for each in arrays
        ),
        *(ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ADD, ca.OP_SUB, ca.OP_MUL),
    )
    # Kept as long as the pointers to them.
    found.arrays = arrays
    return found


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
