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
from stiffopt.recording.readers.episodes import information, split_episode
from stiffopt.recording.readers.limits import (
    MOST_MEMORY,
    MOST_SECONDS,
    OutOfTime,
    bounded_memory,
    bounded_time,
)
from stiffopt.recording.readers.messages import Message
from stiffopt.recording.signals import Signals

# Far beyond any measurement, stamps in nanoseconds included; larger ones overflow when squared.
LARGEST = 1e30
# Far below any digit of a sensor.
SMALLEST = 1e-30

Columns = dict[str, np.ndarray]
Read = TypeVar("Read")

# Module of each ending; those with libraries of their own are imported only when needed.
_READERS = {
    ".csv": "csv",
    ".txt": "csv",
    ".tsv": "csv",
    ".npz": "npz",
    ".parquet": "parquet",
    ".mcap": "mcap",
    ".db3": "rosbag2",
    ".dat": "kuka_trace",
}
_BAG = "rosbag2"
_NAMES = {
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
    module = _module(path)
    reader = _reader(module, path)
    columns: Columns = bounded(lambda: reader.read(path, signals), path, _NAMES[module])
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name}: {count}" for name, count in lengths.items())
        raise InputFileError(path, "", f"the columns have unequal lengths: {listed}.")
    for name, column in columns.items():
        # Squares of smaller numbers underflow: they are none of a sensor.
        columns[name] = np.where(np.abs(column) < SMALLEST, 0.0, column)
        senseless = np.isfinite(column) & (np.abs(column) > LARGEST)
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
        if _READERS.get(file.suffix.lower()) == "parquet":
            found += filter(None, [information(file)])
        if _READERS.get(file.suffix.lower()) == "kuka_trace":
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
    module = _module(path)
    reader = _reader(module, path)
    return bounded(lambda: list(islice(reader.peek(path), count)), path, _NAMES[module])


def _module(path: Path) -> str:
    """Name of the module that reads a file."""
    if path.is_dir() and (path / "metadata.yaml").is_file():
        return _BAG
    file, episode = split_episode(path)
    check_file(file)
    module = _READERS.get(file.suffix.lower(), "")
    if not module:
        raise InputFileError(
            path, "", f"cannot be read: the ending {path.suffix!r} is none of "
            f"{', '.join(_READERS)}, nor is it the folder of a rosbag2."
        )  # fmt: skip
    if module == "parquet" and (episode is not None or information(file)):
        return "lerobot"
    return module


def _reader(module: str, path: Path) -> Any:
    try:
        return import_module(f"stiffopt.recording.readers.{module}")
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: reading it needs the package {error.name!r}. "
            "Install it with: pip install 'stiffopt[recordings]'"
        ) from error


def bounded(read: Callable[[], Read], path: Path, name: str) -> Read:
    """What a format's reader gives; whatever its library meets in a wrong file is one sentence."""
    try:
        with bounded_memory(), bounded_time():
            return read()
    except InputError:
        raise
    except OutOfTime as error:
        raise InputFileError(
            path, "", f"cannot be read as {name} within {MOST_SECONDS:g} s. Split it, or check "
            "that it is whole."
        ) from error  # fmt: skip
    except MemoryError as error:
        raise InputFileError(
            path, "", f"cannot be read as {name}: it needs more than "
            f"{MOST_MEMORY / 2**30:.1f} GiB of memory. Split it, or check that it is whole."
        ) from error  # fmt: skip
    except Exception as error:  # each library has errors of its own, and lets those below through
        reason = shortened(error) or type(error).__name__
        raise InputFileError(
            path, "", f"cannot be read as {name}: {reason}. Check the file, or record it anew."
        ) from error
