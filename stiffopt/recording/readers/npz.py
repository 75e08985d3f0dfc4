"""Run files of NumPy: one array per column, or matrices of one."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.checks import check_numbers, require_time
from stiffopt.recording.readers.columns import Table, columns_of_arrays, select_columns
from stiffopt.recording.readers.npy import read_header
from stiffopt.recording.signals import Signals


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Read columns of an .npz file; entry k of a matrix "q" is "q[k]"."""
    require_time(signals, path)
    wanted = (signals.time, *signals.wanted)
    with zipfile.ZipFile(path) as archive:
        held = [name.removesuffix(".npy") for name in archive.namelist()]
        whole = set(wanted) <= set(held)
        for name in wanted if whole else ():
            _check_size(path, archive, name, len(wanted))
    if not whole:
        return select_columns(path, read_tables(path)[""], signals)
    with np.load(path, allow_pickle=False) as arrays:
        return {name: _as_numbers(path, name, arrays[name]) for name in wanted}


def read_tables(path: Path) -> dict[str, Table]:
    """Read the table of all arrays of an .npz file."""
    with zipfile.ZipFile(path) as archive:
        held = [name.removesuffix(".npy") for name in archive.namelist()]
        headers = {name: _read_header(archive, name) for name in held}
    numeric = {name: shape for name, (shape, kind) in headers.items() if kind.kind in "fiub"}
    check_numbers(path, sum(math.prod(shape) for shape in numeric.values()), 1)
    with np.load(path, allow_pickle=False) as arrays:
        return {"": columns_of_arrays({name: arrays[name] for name in numeric})}


def _check_size(path: Path, archive: zipfile.ZipFile, name: str, columns: int) -> None:
    """Raise `InputFileError` where the header of an array declares too many numbers."""
    shape, kind = _read_header(archive, name)
    if kind.kind not in "fiub":
        raise InputFileError(path, name, f"needs a list of numbers, got {kind}.")
    check_numbers(path, math.prod(shape), columns)


def _read_header(archive: zipfile.ZipFile, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return shape and type of an array, from its header."""
    with archive.open(f"{name}.npy") as stream:
        return read_header(stream)


def _as_numbers(path: Path, name: str, array: np.ndarray) -> np.ndarray:
    if array.ndim == 2 and 1 in array.shape:
        array = array.reshape(-1)
    if array.ndim != 1 or array.dtype.kind not in "fiub":
        raise InputFileError(
            path, name, f"needs a list of numbers, got shape {array.shape} of {array.dtype}."
        )
    return array.astype(float)
