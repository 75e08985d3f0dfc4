"""Reading of run files and recognition of their formats."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from stiffopt.errors import InputError, InputFileError, shortened
from stiffopt.files import check_file
from stiffopt.recording.readers import checks, kuka_trace
from stiffopt.recording.readers.columns import select_columns
from stiffopt.recording.readers.messages import Message
from stiffopt.recording.signals import Signals

# Beyond any measurement and any stamp in nanoseconds; squares do not overflow.
MAX_MAGNITUDE = 1e30
# Below any resolution of a sensor.
MIN_MAGNITUDE = 1e-30

Columns = dict[str, np.ndarray]
Read = TypeVar("Read")

# Module of each ending; imported when needed, since some require optional libraries.
_READER_OF_ENDING = {
    ".csv": "csv",
    ".txt": "csv",
    ".tsv": "csv",
    ".log": "csv",
    ".dat": "csv",
    ".yaml": "csv",
    ".npz": "npz",
    ".npy": "npy",
    ".parquet": "parquet",
    ".json": "json_log",
    ".jsonl": "json_log",
    ".ndjson": "json_log",
    ".mat": "matlab",
    ".xlsx": "excel",
    ".xlsm": "excel",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".mcap": "mcap",
    ".db3": "rosbag2",
}
SET_FILE = "recordings.toml"
_BAG_READER = "rosbag2"
_TRACE_READER, _TRACE_ENDING, _TRACE_MARK = "kuka_trace", ".dat", b"#BEGIN"
_FORMAT_NAMES = {
    "csv": "a text file",
    "npz": "an NPZ file of numbers",
    "npy": "an NPY file of numbers",
    "parquet": "Parquet",
    "json_log": "JSON",
    "matlab": "a MATLAB file",
    "excel": "an Excel workbook",
    "hdf5": "HDF5",
    "mcap": "MCAP",
    "rosbag2": "a rosbag2",
    "kuka_trace": "a KUKA trace",
}
# Formats that are not read: name, and how to convert them.
_CONVERSION_ADVICE = {
    ".bag": ("a bag of ROS 1", "convert it: rosbags-convert --src FILE.bag --dst FOLDER"),
    ".xls": ("an Excel workbook of 1997", "save it as .xlsx or CSV"),
    ".xlsb": ("a binary Excel workbook", "save it as .xlsx or CSV"),
    ".ods": ("an OpenDocument sheet", "save it as .xlsx or CSV"),
    ".pkl": ("a Python pickle, which may run any code", "save its arrays with numpy.savez"),
    ".pickle": ("a Python pickle, which may run any code", "save its arrays with numpy.savez"),
    ".pt": ("a PyTorch file, which may run any code", "save its arrays with numpy.savez"),
    ".feather": ("Feather", "pandas.read_feather(FILE).to_parquet(OUT)"),
    ".arrow": ("Arrow", "pandas.read_feather(FILE).to_parquet(OUT)"),
    ".tdms": ("TDMS of LabVIEW", "with nptdms, TdmsFile(FILE).as_dataframe().to_csv(OUT)"),
    ".mf4": ("MDF", "with asammdf, MDF(FILE).export('csv', OUT)"),
    ".mdf": ("MDF", "with asammdf, MDF(FILE).export('csv', OUT)"),
    ".ulg": ("a ULog of PX4", "convert it: ulog2csv FILE"),
    ".rrd": ("a recording of Rerun", "export its dataframe as Parquet"),
    ".zarr": ("Zarr", "save its arrays with numpy.savez"),
    ".slx": ("a Simulink model", "log its signals and save them to a .mat file"),
}  # fmt: skip
# Endings by which files of a folder are taken for recordings.
RUN_ENDINGS = tuple(ending for ending in _READER_OF_ENDING if ending not in (".json", ".yaml"))


def read_columns(path: str | os.PathLike[str], signals: Signals) -> Columns:
    """Read time and channels of a run file.

    `path`: text, JSON, NPZ, Parquet, MATLAB, Excel, HDF5, MCAP, a rosbag2 (its folder or the .db3
    inside), the .dat of a KUKA trace; "FILE#PART" for one of several runs in it: an episode of a
    LeRobot dataset ("data/chunk-000/file-000.parquet#3"), a group of HDF5, a sheet. Returns mapping
    of column name to array (R,): the time under `signals.time` ("" for the stamps of messages) and
    every column that `signals` names, as recorded. Raises `InputFileError`: no such file, an
    unknown format, a missing column (with those of the file), or content that is no series of
    numbers. Raises `InputError`: the format needs libraries that are not installed.
    """
    path = Path(path)
    reader, form = _import_reader(path)

    def read() -> Columns:
        if hasattr(reader, "read"):
            return dict(reader.read(path, signals))
        return select_columns(path, _table_of_part(reader, path), signals)

    columns = read_bounded(read, path, form)
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name}: {count}" for name, count in lengths.items())
        raise InputFileError(path, "", f"the columns have unequal lengths: {listed}.")
    for name, column in columns.items():
        # Squares of smaller numbers underflow.
        columns[name] = np.where(np.abs(column) < MIN_MAGNITUDE, 0.0, column)
        senseless = np.isfinite(column) & (np.abs(column) > MAX_MAGNITUDE)
        if senseless.any():
            row = int(np.argmax(senseless))
            raise InputFileError(
                path, name, f"holds {column[row]:.3g} in row {row + 1}: no measurement is so large."
                " Correct the file, or write nan for missing samples."
            )  # fmt: skip
    return columns


def read_tables(path: Path) -> dict[str, Columns]:
    """Read all numeric columns of a file, by run; "" where it holds one run.

    Raises `InputFileError` or `InputError`: see `read_columns`.
    """
    reader, form = _import_reader(path)
    tables: dict[str, Columns] = read_bounded(lambda: reader.read_tables(path), path, form)
    if not all(tables.values()):
        raise InputFileError(path, "", f"was read as {form} and holds no columns of numbers.")
    return tables


def read_named_columns(path: Path, names: Sequence[str]) -> Columns:
    """Read columns (R,) of a file of one table, or of "FILE#PART"; errors as of `read_columns`."""
    reader, form = _import_reader(path)

    def read() -> Columns:
        table = _table_of_part(reader, path)
        checks.check_columns(path, names, table, "the set")
        return {name: np.asarray(table[name], dtype=float) for name in names}

    return read_bounded(read, path, form)


def _table_of_part(reader: Any, path: Path) -> Columns:
    file, part = checks.split_part(path)
    tables: dict[str, Columns] = reader.read_tables(file)
    if part is None and len(tables) == 1:
        (part,) = tables
    if part not in tables:
        first = f"{file.name}#{next(iter(tables))}"
        raise InputFileError(
            path, "", f"holds the runs {', '.join(tables)}. Name one of them as {first}."
        )
    return tables[part]


def files_of(path: Path) -> list[Path]:
    """List the files of a run and of its metadata; empty where there is no such run."""
    if path.suffix.lower() == ".db3" and (path.parent / "metadata.yaml").is_file():
        path = path.parent
    if path.is_dir():
        found = sorted(path.iterdir())
    else:
        file, _ = checks.split_part(path)
        found = [file]
        if _READER_OF_ENDING.get(file.suffix.lower()) == "parquet":
            found += filter(None, [checks.find_dataset_info(file)])
        if file.suffix.lower() == _TRACE_ENDING:
            found = kuka_trace.files_of(file)
    return [each for each in found if each.is_file()]


def is_messages(path: Path) -> bool:
    """Return whether a path is a log of messages: MCAP, or a rosbag2 by folder or storage."""
    return (path.is_dir() and (path / "metadata.yaml").is_file()) or path.suffix.lower() in (
        ".mcap",
        ".db3",
    )


def first_messages(path: Path, count: int) -> list[Message]:
    """Read the first messages of an MCAP file or a rosbag2: topic, log time [ns], content."""
    reader, form = _import_reader(path)
    return read_bounded(lambda: list(islice(reader.peek(path), count)), path, form)


def _select_reader(path: Path) -> str:
    """Return the name of the module that reads a file."""
    if path.is_dir() and (path / "metadata.yaml").is_file():
        return _BAG_READER
    file, _ = checks.split_part(path)
    check_file(file)
    ending = file.suffix.lower()
    if ending in _CONVERSION_ADVICE:
        name, how = _CONVERSION_ADVICE[ending]
        raise InputFileError(path, "", f"is {name}, which is not read: {how}.")
    module = _TRACE_READER if _is_trace(file) else _READER_OF_ENDING.get(ending, "")
    if not module:
        raise InputFileError(
            path, "", f"cannot be read: the ending {file.suffix!r} is none of "
            f"{', '.join(_READER_OF_ENDING)}, nor is it the folder of a rosbag2."
        )  # fmt: skip
    return module


def _is_trace(path: Path) -> bool:
    """Return True for the header of a KUKA trace, by its first lines."""
    if path.suffix.lower() != _TRACE_ENDING or not path.is_file():
        return False
    with path.open("rb") as stream:
        return _TRACE_MARK in stream.read(4096)


def _import_reader(path: Path) -> tuple[Any, str]:
    """Return the module that reads a file, and the name of its format."""
    module = _select_reader(path)
    try:
        return import_module(f"stiffopt.recording.readers.{module}"), _FORMAT_NAMES[module]
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: reading it needs the package {error.name!r}. "
            "Install it with: pip install 'stiffopt[recordings]'"
        ) from error


def read_bounded(read: Callable[[], Read], path: Path, name: str) -> Read:
    """Run a reader within bounds of time and memory; its errors become an `InputFileError`."""
    try:
        with checks.bounded_memory(), checks.bounded_time():
            return read()
    except InputError:
        raise
    except checks.ReadTimeout as error:
        raise InputFileError(
            path, "", f"cannot be read as {name} within {checks.MAX_SECONDS:g} s. Split it, or "
            "check that it is whole."
        ) from error  # fmt: skip
    except MemoryError as error:
        raise InputFileError(
            path, "", f"cannot be read as {name}: it needs more than "
            f"{checks.MAX_MEMORY / 2**30:.1f} GiB of memory. Split it, or check that it is whole."
        ) from error  # fmt: skip
    except Exception as error:  # libraries raise errors of many kinds
        reason = shortened(error) or type(error).__name__
        raise InputFileError(
            path, "", f"cannot be read as {name}: {reason}. Check the file, or record it again."
        ) from error


def find_set_file(path: Path) -> Path:
    """Find recordings.toml of a set, given by its folder or its path.

    Raises `InputFileError`: recordings without one; the message names the command that writes it.
    """
    file = path / SET_FILE if path.is_dir() else path
    if path.is_file() and path.suffix.lower() in RUN_ENDINGS:
        raise InputFileError(
            path, "", "is a recording, not a recording set, which names its columns:"
            f" `stiffopt init recording {path} --urdf ROBOT.urdf` writes one."
        )  # fmt: skip
    bare = path.is_dir() and not file.exists()
    if bare and any(each.suffix.lower() in RUN_ENDINGS for each in path.iterdir()):
        raise InputFileError(
            path, "", f"holds recordings, but no {SET_FILE} that names their columns:"
            f" `stiffopt init recording {path} --urdf ROBOT.urdf` writes one."
        )  # fmt: skip
    return file
