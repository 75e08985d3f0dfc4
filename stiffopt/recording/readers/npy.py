"""Run files of NumPy: one matrix, without names of columns."""

from __future__ import annotations

import math
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.checks import check_numbers
from stiffopt.recording.readers.columns import MAX_ENTRIES, Table, unnamed_columns


def read_tables(path: Path) -> dict[str, Table]:
    """Read the columns of an .npy file: of a structured array by name, else "column 1", ..."""
    with path.open("rb") as stream:
        check_numbers(path, math.prod(read_header(stream)[0]), 1)
    array = np.load(path, allow_pickle=False)
    if array.dtype.names:
        return {"": {name: array[name].reshape(-1).astype(float) for name in array.dtype.names}}
    array = array.reshape(-1, 1) if array.ndim == 1 else array
    if array.ndim != 2 or min(array.shape) > MAX_ENTRIES:
        raise InputFileError(path, "", f"needs one row for each sample, got shape {array.shape}.")
    rows = array if array.shape[0] >= array.shape[1] else array.T
    names = unnamed_columns(rows.shape[1])
    return {"": {name: rows[:, k].astype(float) for k, name in enumerate(names)}}


def read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Read shape and type of an array from its header."""
    version = npy.read_magic(stream)
    header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, kind = header(stream)
    return shape, kind
