"""Columns of a run file, whatever its format."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from stiffopt.errors import InputError, InputFileError, shortened
from stiffopt.files import check_file
from stiffopt.recording.readers import kuka_trace
from stiffopt.recording.readers.checks import (
    MAX_MEMORY,
    MAX_SECONDS,
    ReadTimeout,
    bounded_memory,
    bounded_time,
    find_dataset_info,
    split_episode,
)
from stiffopt.recording.readers.messages import Message
from stiffopt.recording.signals import Signals

# Far beyond any measurement, stamps in nanoseconds included; larger ones overflow when squared.
MAX_MAGNITUDE = 1e30
# Far below any digit of a sensor.
MIN_MAGNITUDE = 1e-30

Columns = dict[str, np.ndarray]
Read = TypeVar("Read")

# Module of each ending; those with libraries of their own are imported only when needed.
_READER_OF_ENDING = {
    ".csv": "csv",
    ".txt": "csv",
    ".tsv": "csv",
    ".npz": "npz",
    ".parquet": "parquet",
    ".mcap": "mcap",
    ".db3": "rosbag2",
    ".dat": "kuka_trace",
}
SET_FILE = "recordings.toml"
# Endings of recordings as they come from a logger.
_RUN_ENDINGS = (*_READER_OF_ENDING, ".log")
_BAG_READER = "rosbag2"
_FORMAT_NAMES = {
    "csv": "a CSV text file",
    "npz": "an NPZ file of numbers",
    "parquet": "Parquet",
    "mcap": "MCAP",
    "rosbag2": "a rosbag2",
    "kuka_trace": "a KUKA trace",
    "lerobot": "an episode of a LeRobot dataset",
}


def read_columns(path: str | os.PathLike[str], signals: Signals) -> Columns:
    """Time and channels of a run file.

    Parameters
    ----------
    path : path
        CSV, NPZ, Parquet, MCAP, a rosbag2 (its folder or the .db3 inside), the .dat of a KUKA
        trace, or an episode of a LeRobot dataset ("data/chunk-000/file-000.parquet#3").
    signals : Signals

    Returns
    -------
    mapping of column name to array (R,)
        The time under `signals.time` ("" for the stamps of messages) and every column that
        `signals` names, as recorded.

    Raises
    ------
    InputFileError
        No such file, a format that is not read, a column missing (with the names there are), or
        content that is no series of numbers.
    InputError
        The format needs libraries that are not installed.
    """
    path = Path(path)
    module = _select_reader(path)
    reader = _import_reader(module, path)
    columns: Columns = read_bounded(lambda: reader.read(path, signals), path, _FORMAT_NAMES[module])
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name}: {count}" for name, count in lengths.items())
        raise InputFileError(path, "", f"the columns have unequal lengths: {listed}.")
    for name, column in columns.items():
        # Squares of smaller numbers underflow: they are none of a sensor.
        columns[name] = np.where(np.abs(column) < MIN_MAGNITUDE, 0.0, column)
        senseless = np.isfinite(column) & (np.abs(column) > MAX_MAGNITUDE)
        if senseless.any():
            row = int(np.argmax(senseless))
            raise InputFileError(
                path, name, f"holds {column[row]:.3g} in row {row + 1}: no measurement is so large."
                " Mend the file, or put nan where nothing was measured."
            )  # fmt: skip
    return columns


def files_of(path: Path) -> list[Path]:
    """Files that a run is read from, with what describes them; none where there is no such run."""
    if path.suffix.lower() == ".db3" and (path.parent / "metadata.yaml").is_file():
        path = path.parent
    if path.is_dir():
        found = sorted(path.iterdir())
    else:
        file, _ = split_episode(path)
        found = [file]
        if _READER_OF_ENDING.get(file.suffix.lower()) == "parquet":
            found += filter(None, [find_dataset_info(file)])
        if _READER_OF_ENDING.get(file.suffix.lower()) == "kuka_trace":
            found = kuka_trace.files_of(file)
    return [each for each in found if each.is_file()]


def is_messages(path: Path) -> bool:
    """Whether a file holds messages by topic: MCAP, or a rosbag2 by its folder or storage."""
    return (path.is_dir() and (path / "metadata.yaml").is_file()) or path.suffix.lower() in (
        ".mcap",
        ".db3",
    )


def first_messages(path: Path, count: int) -> list[Message]:
    """The first messages of an MCAP file or a rosbag2: topic, log time [ns], content.

    Raises
    ------
    InputFileError, InputError
        As of `read_columns`.
    """
    module = _select_reader(path)
    reader = _import_reader(module, path)
    return read_bounded(lambda: list(islice(reader.peek(path), count)), path, _FORMAT_NAMES[module])


def _select_reader(path: Path) -> str:
    """Name of the module that reads a file."""
    if path.is_dir() and (path / "metadata.yaml").is_file():
        return _BAG_READER
    file, episode = split_episode(path)
    check_file(file)
    module = _READER_OF_ENDING.get(file.suffix.lower(), "")
    if not module:
        raise InputFileError(
            path, "", f"cannot be read: the ending {path.suffix!r} is none of "
            f"{', '.join(_READER_OF_ENDING)}, nor is it the folder of a rosbag2."
        )  # fmt: skip
    if module == "parquet" and (episode is not None or find_dataset_info(file)):
        return "lerobot"
    return module


def _import_reader(module: str, path: Path) -> Any:
    try:
        return import_module(f"stiffopt.recording.readers.{module}")
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: reading it needs the package {error.name!r}. "
            "Install it with: pip install 'stiffopt[recordings]'"
        ) from error


def read_bounded(read: Callable[[], Read], path: Path, name: str) -> Read:
    """What a format's reader gives; whatever its library meets in a wrong file is one sentence."""
    try:
        with bounded_memory(), bounded_time():
            return read()
    except InputError:
        raise
    except ReadTimeout as error:
        raise InputFileError(
            path, "", f"cannot be read as {name} within {MAX_SECONDS:g} s. Split it, or check "
            "that it is whole."
        ) from error  # fmt: skip
    except MemoryError as error:
        raise InputFileError(
            path, "", f"cannot be read as {name}: it needs more than "
            f"{MAX_MEMORY / 2**30:.1f} GiB of memory. Split it, or check that it is whole."
        ) from error  # fmt: skip
    except Exception as error:  # each library has errors of its own, and lets those below through
        reason = shortened(error) or type(error).__name__
        raise InputFileError(
            path, "", f"cannot be read as {name}: {reason}. Check the file, or record it anew."
        ) from error


def find_set_file(path: Path) -> Path:
    """The recordings.toml of a set, given by its folder or itself.

    Raises
    ------
    InputFileError
        For recordings that have none yet, with what to do.
    """
    file = path / SET_FILE if path.is_dir() else path
    if path.is_file() and path.suffix.lower() in _RUN_ENDINGS:
        raise InputFileError(
            path, "", "is a recording, not a recording set, which says what its columns are:"
            f" `stiffopt init recording {path} --urdf ROBOT.urdf` writes one."
        )  # fmt: skip
    bare = path.is_dir() and not file.exists()
    if bare and any(each.suffix.lower() in _RUN_ENDINGS for each in path.iterdir()):
        raise InputFileError(
            path, "", f"holds recordings, but no {SET_FILE} that says what their columns are:"
            f" `stiffopt init recording {path} --urdf ROBOT.urdf` writes one."
        )  # fmt: skip
    return file
