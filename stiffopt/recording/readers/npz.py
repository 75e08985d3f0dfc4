"""Run files of NumPy: one array a column name."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from stiffopt.errors import InputError, InputFileError
from stiffopt.recording.readers.columns import missing, require_time
from stiffopt.recording.signals import Signals


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Columns of an .npz file."""
    require_time(signals, path)
    try:
        with np.load(path, allow_pickle=False) as archive:
            wanted = (signals.time, *signals.wanted)
            missing(path, wanted, archive.files)
            return {name: _numbers(path, name, archive[name]) for name in wanted}
    except InputError:
        raise
    except (zipfile.BadZipFile, ValueError, OSError, EOFError, AttributeError) as error:
        raise InputFileError(path, "", f"is not an NPZ file of numbers: {error}.") from error


def _numbers(path: Path, name: str, array: np.ndarray) -> np.ndarray:
    if array.ndim == 2 and 1 in array.shape:
        array = array.reshape(-1)
    if array.ndim != 1 or array.dtype.kind not in "fiub":
        raise InputFileError(
            path, name, f"needs a list of numbers, got shape {array.shape} of {array.dtype}."
        )
    return array.astype(float)
