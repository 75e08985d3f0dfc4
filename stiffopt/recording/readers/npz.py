"""Run files of NumPy: one array per column."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.checks import check_columns, check_numbers, require_time
from stiffopt.recording.signals import Signals


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Read columns of an .npz file."""
    require_time(signals, path)
    wanted = (signals.time, *signals.wanted)
    with zipfile.ZipFile(path) as archive:
        held = [name.removesuffix(".npy") for name in archive.namelist()]
        check_columns(path, wanted, held)
        for name in wanted:
            _check_size(path, archive, name, len(wanted))
    with np.load(path, allow_pickle=False) as arrays:
        return {name: _as_numbers(path, name, arrays[name]) for name in wanted}


def _check_size(path: Path, archive: zipfile.ZipFile, name: str, columns: int) -> None:
    """Raise `InputFileError` where the header of an array declares too many numbers."""
    with archive.open(f"{name}.npy") as stream:
        version = npy.read_magic(stream)
        header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, kind = header(stream)
    if kind.kind not in "fiub":
        raise InputFileError(path, name, f"needs a list of numbers, got {kind}.")
    check_numbers(path, math.prod(shape), columns)


def _as_numbers(path: Path, name: str, array: np.ndarray) -> np.ndarray:
    if array.ndim == 2 and 1 in array.shape:
        array = array.reshape(-1)
    if array.ndim != 1 or array.dtype.kind not in "fiub":
        raise InputFileError(
            path, name, f"needs a list of numbers, got shape {array.shape} of {array.dtype}."
        )
    return array.astype(float)
