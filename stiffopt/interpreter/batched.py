"""A CasADi function as one of `POINTS` points a call, evaluated by interpreter.c.

A function of a hundred thousand operations is numbers that a few dozen loops read: each loop is one
computation, of other places of a work vector every time, for all points.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import numpy as np

from .batches import batches, places
from .instructions import instructions
from .operations import operations_of

# Points of a call, as interpreter.c is compiled for them.
POINTS = 16


def batched(
    library: Path, function: ca.Function, shared: tuple[int, ...] = (), *, recalled: bool = False
) -> ca.Function | None:
    """The function at `POINTS` points at once.

    Parameters
    ----------
    library : Path
        That interpreter.c is part of.
    function : casadi.Function
        Of SX. Inputs and outputs of the points stand side by side: (m, n) becomes (m, POINTS n).
    shared : tuple of int
        Inputs that are the same at all points.
    recalled : bool
        Keep the outputs of the last calls, for functions of one output that are called with the
        same inputs again and again.

    Returns
    -------
    casadi.Function or None
        None where too many are in use.
    """
    loaded, kinds = _loaded(library)
    operations = operations_of(function)
    listed = batches(instructions(operations, kinds))
    given = [v for v in range(len(operations.values)) if not operations.is_computed(v)]
    place, count = places(given, listed, [value for _, _, value in operations.results])
    at = {value: POINTS * number for value, number in place.items()}
    inputs = [v for v in given if operations.values[v][0] == ca.OP_INPUT]
    constants = [v for v in given if operations.values[v][0] == ca.OP_CONST]
    widths = [function.nnz_in(i) * (i not in shared) for i in range(function.n_in())]
    patterns = [_of_points(function.sparsity_in(i), i in shared) for i in range(function.n_in())]
    patterns += [_of_points(function.sparsity_out(i), False) for i in range(function.n_out())]
    compressed = [pattern.compress() for pattern in patterns]
    lists: list[Sequence[int]] = [
        [k for v in inputs for k in (*operations.values[v][1], at[v])],
        [at[v] for v in constants],
        [k for batch in listed for k in (kinds[batch[0].kind], len(batch))],
        [at[v] for batch in listed for each in batch for v in (each.value, *each.read)],
        [k for out, row, v in operations.results for k in (out, row, at[v])],
        widths,
        [function.nnz_in(i) * (POINTS if width else 1) for i, width in enumerate(widths)],
        [function.nnz_out(i) for i in range(function.n_out())],
        np.cumsum([0, *map(len, compressed)])[:-1].tolist(),
    ]
    ends = np.cumsum([len(each) + 1 for each in lists])
    slot = loaded.batch_load(
        _pointer(np.append(0, ends), np.int32),
        _pointer(np.concatenate([k for each in lists for k in (each, [-1])]), np.int32),
        ctypes.c_longlong(ends[-1]),
        _pointer([float.fromhex(operations.values[v][1][0]) for v in constants], float),
        ctypes.c_longlong(len(constants)),
        _pointer(np.concatenate(compressed), np.int64),
        ctypes.c_longlong(sum(map(len, compressed))),
        # A place more, of which the first registers are aligned.
        _pointer([function.n_in(), function.n_out(), POINTS * count + 8, recalled], np.int64),
    )
    return None if slot < 0 else ca.external(f"batch_{slot:03x}", str(library))


@functools.cache
def _loaded(library: Path) -> tuple[ctypes.CDLL, dict[str, int]]:
    """The library, and numbers of the kinds of instructions."""
    loaded = ctypes.CDLL(str(library))
    loaded.batch_kinds.restype = ctypes.POINTER(ctypes.c_char_p)
    names: list[str] = []
    for name in loaded.batch_kinds():
        if name is None:
            break
        names.append(name.decode())
    return loaded, {name: number for number, name in enumerate(names)}


def _pointer(values: object, kind: type) -> ctypes.c_void_p:
    array: np.ndarray = np.ascontiguousarray(values, dtype=kind)
    pointer = ctypes.c_void_p(array.ctypes.data)
    # Kept as long as the pointer is.
    pointer.array = array  # type: ignore[attr-defined]
    return pointer


def _of_points(sparsity: ca.Sparsity, same: bool) -> ca.Sparsity:
    return sparsity if same else ca.repmat(sparsity, 1, POINTS)
