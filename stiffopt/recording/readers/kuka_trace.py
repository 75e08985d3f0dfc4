"""Traces of KUKA controllers: a .dat header of channels, and the .r64 of their values beside it.

A trace is several such pairs: NAME_KRCIpo for the axes, NAME_NextGenDrive#1 and so on for the
drives. A channel of another pair of the same trace is named with it: "NextGenDrive#1.Istmoment".
"""

from __future__ import annotations

from dataclasses import dataclass
from glob import escape
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import read_bytes
from stiffopt.recording.readers.checks import check_bytes, check_columns, check_numbers
from stiffopt.recording.readers.columns import Table
from stiffopt.recording.signals import Signals

# Keys of a channel header: name, kind and type of values, column, offset, step.
_NAME_KEY, _KIND_KEY, _TYPE_KEY, _COLUMN_KEY = "200", "210", "214", "221"
_OFFSET_KEY, _STEP_KEY = "240", "241"
_TIME_NAMES = ("Zeit", "Time", "t")


@dataclass
class _Trace:
    """One pair of files: values (R, channels), names, and the sample time [s]."""

    step: float
    names: list[str]
    values: np.ndarray

    @property
    def time(self) -> np.ndarray:
        return np.arange(len(self.values)) * self.step


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Read columns of a trace, given by the .dat of one of its pairs, on the clock of that pair.

    The time is that of the pair, under the name `signals.time`. Channels of other pairs are
    interpolated linearly, NaN outside of their time.
    """
    traces = {"": _read_trace(path)}
    own = traces[""]
    columns: dict[str, np.ndarray] = {signals.time: own.time}
    for name in signals.wanted:
        if name in own.names:
            columns[name] = own.values[:, own.names.index(name)]
            continue
        other, _, channel = name.partition(".")
        beside = path.with_name(f"{path.stem.rpartition('_')[0]}_{other}{path.suffix}")
        if not channel or not beside.is_file():
            check_columns(path, [name], own.names)
        if other not in traces:
            traces[other] = _read_trace(beside)
        found = traces[other]
        check_columns(beside, [channel], found.names)
        values = found.values[:, found.names.index(channel)]
        columns[name] = np.interp(own.time, found.time, values, left=np.nan, right=np.nan)
    return columns


def read_tables(path: Path) -> dict[str, Table]:
    """Read the table of a trace, with the channels of all its pairs on the clock of this one."""
    own = _read_trace(path)
    table: Table = {_TIME_NAMES[0]: own.time}
    table |= {name: own.values[:, k] for k, name in enumerate(own.names)}
    for beside in files_of(path):
        if beside.suffix.lower() != path.suffix.lower() or beside == path:
            continue
        trace, prefix = _read_trace(beside), beside.stem.rpartition("_")[2]
        for k, name in enumerate(trace.names):
            table[f"{prefix}.{name}"] = np.interp(
                own.time, trace.time, trace.values[:, k], left=np.nan, right=np.nan
            )
    return {"": table}


def files_of(path: Path) -> list[Path]:
    """List all files of the trace that a .dat belongs to."""
    name = path.stem.rpartition("_")[0]
    pairs = sorted(path.parent.glob(f"{escape(name)}_*{path.suffix}")) if name else []
    return [each for pair in (path, *pairs) for each in (pair, pair.with_suffix(".r64"))]


def _read_trace(path: Path) -> _Trace:
    """Read header and values of one pair of files."""
    channels = _read_channel_headers(path)
    stored = [each for each in channels if each.get(_KIND_KEY, "").upper().startswith("EXPLI")]
    clock = next((each for each in channels if each.get(_NAME_KEY, "") in _TIME_NAMES), None)
    step = 0.0 if clock is None else _header_number(path, clock, _STEP_KEY, 0.0)
    if not stored or not step > 0.0:
        raise InputFileError(path, "", "is no KUKA trace: it declares no channels over time.")
    for each in stored:
        if each.get(_TYPE_KEY, "REAL64").upper() != "REAL64":
            raise InputFileError(
                path, each.get(_NAME_KEY, ""), f"holds {each[_TYPE_KEY]} values; REAL64 is read."
            )
    data = path.with_suffix(".r64")
    if not data.is_file():
        raise InputFileError(
            data, "", f"the values of {path.name} are not beside it. Copy the whole trace folder."
        )
    check_bytes(data, data.stat().st_size)
    numbers = np.fromfile(data, dtype="<f8")
    rows = len(numbers) // len(stored)
    check_numbers(data, rows, len(stored))
    if rows == 0 or rows * len(stored) != len(numbers):
        raise InputFileError(
            data, "", f"holds {len(numbers)} numbers, no whole rows of the {len(stored)} channels "
            f"that {path.name} declares. Copy it again."
        )  # fmt: skip
    table = numbers.reshape(rows, len(stored))
    names, columns = [], []
    for k, each in enumerate(stored, start=1):
        column = int(_header_number(path, each, _COLUMN_KEY, k))
        if not 1 <= column <= len(stored):
            raise InputFileError(
                path, each.get(_NAME_KEY, ""), f"has no column {column} in the data."
            )
        names.append(each.get(_NAME_KEY, ""))
        offset, scale = (
            _header_number(path, each, _OFFSET_KEY, 0.0),
            _header_number(path, each, _STEP_KEY, 1.0),
        )
        with np.errstate(invalid="ignore", over="ignore"):  # bytes that are no numbers
            columns.append(offset + scale * table[:, column - 1])
    return _Trace(step, names, np.stack(columns, axis=1))


def _read_channel_headers(path: Path) -> list[dict[str, str]]:
    """Read the headers of all channels, by key number."""
    channels: list[dict[str, str]] = []
    inside = False
    for line in read_bytes(path).decode("latin-1").splitlines():
        text = line.strip()
        if text == "#BEGINCHANNELHEADER":
            channels.append({})
        inside = text == "#BEGINCHANNELHEADER" or (inside and text != "#ENDCHANNELHEADER")
        key, comma, value = text.partition(",")
        if inside and comma:
            channels[-1][key] = value.strip()
    return channels


def _header_number(path: Path, channel: dict[str, str], key: str, default: float) -> float:
    try:
        return float(channel.get(key) or default)
    except ValueError:
        raise InputFileError(
            path, channel.get(_NAME_KEY, ""), f"{channel[key]!r} is no number (key {key})."
        ) from None
