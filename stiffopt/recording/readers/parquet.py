"""Run files of Parquet: columns, entries of vectors, and episodes of LeRobot datasets."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as arrow
import pyarrow.compute as compute
import pyarrow.parquet as parquet

from stiffopt.errors import InputFileError, nearest
from stiffopt.files import load_json
from stiffopt.recording.readers import checks
from stiffopt.recording.readers.columns import MAX_ENTRIES, Table, expand_vectors
from stiffopt.recording.signals import Signals

_ENTRY_PATTERN = re.compile(r"(.+)\[([^\]]+)\]")
_EPISODE_COLUMN = "episode_index"


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Read columns of a file, of one episode of a LeRobot dataset ("FILE.parquet#3").

    A channel is a column, or an entry of a vector by number or by name:
    "observation.state[0]", "observation.state[shoulder_pan.pos]". Time stamps become seconds after
    the first.
    """
    checks.require_time(signals, path)
    file, part = checks.split_part(path)
    episode = _episode_number(path, part)
    wanted = (signals.time, *signals.wanted)
    entries = {name: _ENTRY_PATTERN.fullmatch(name) for name in wanted}
    needed = [name if match is None else match[1] for name, match in entries.items()]
    with parquet.ParquetFile(file) as source:
        there = source.schema_arrow.names
        checks.check_columns(path, needed, there)
        checks.check_numbers(path, source.metadata.num_rows, len(wanted))
        dataset = episode is not None or checks.find_dataset_info(file) is not None
        index = [_EPISODE_COLUMN] if dataset and _EPISODE_COLUMN in there else []
        table = source.read(columns=list(dict.fromkeys([*needed, *index])), use_threads=False)
    if index:
        table = _select_episode(path, table, episode)
    columns = {}
    for name, match in entries.items():
        if match is None:
            columns[name] = _column_to_numbers(path, name, table.column(name))
        else:
            columns[name] = _vector_entry(
                path, table.column(match[1]), match[1], match[2], vector_names(file, match[1])
            )
    return columns


def _episode_number(path: Path, part: str | None) -> int | None:
    if part is not None and not part.isdecimal():
        raise InputFileError(path, "", f"{part!r} is no episode; give its number, as in #0.")
    return None if part is None else int(part)


def _select_episode(path: Path, table: arrow.Table, episode: int | None) -> arrow.Table:
    """Select the rows of the episode."""
    known = sorted(set(table.column(_EPISODE_COLUMN).to_pylist()))
    if episode is None and len(known) > 1:
        raise InputFileError(
            path, "", f"holds the episodes {known[0]} to {known[-1]}. Name one as a run: "
            f"{path.name}#{known[0]}"
        )  # fmt: skip
    if episode is None:
        return table
    if episode not in known:
        raise InputFileError(path, "", f"there is no episode {episode}; it holds {known}.")
    return table.filter(compute.equal(table.column(_EPISODE_COLUMN), episode))


def _vector_entry(
    path: Path, column: arrow.ChunkedArray, feature: str, entry: str, names: list[str]
) -> np.ndarray:
    """Extract one entry of a column of vectors."""
    kind = column.type
    lists = arrow.types.is_list(kind) or arrow.types.is_fixed_size_list(kind)
    if not lists:
        raise InputFileError(path, feature, f"needs a column of vectors, got {kind}.")
    rows = np.array(column.to_pylist(), dtype=float)
    if entry.isdecimal():
        number = int(entry)
    elif entry in names:
        number = names.index(entry)
    else:
        raise InputFileError(path, feature, f"has no entry {entry!r}. {nearest(entry, names)}")
    if rows.ndim != 2 or number >= rows.shape[1]:
        raise InputFileError(path, feature, f"has no entry {number}: it is of shape {rows.shape}.")
    return rows[:, number]


def read_tables(path: Path) -> dict[str, Table]:
    """Read the table of numbers, time stamps and entries of vectors."""
    table: Table = {}
    with parquet.ParquetFile(path) as file:
        for field in file.schema_arrow:
            if _is_vector(field.type) or _is_number(field.type):
                column = file.read(columns=[field.name], use_threads=False).column(0)
                table |= (
                    _vector_entries(path, field.name, column)
                    if _is_vector(field.type)
                    else {field.name: _column_to_numbers(path, field.name, column)}
                )
    return {"": table}


def _column_to_numbers(path: Path, name: str, column: arrow.ChunkedArray) -> np.ndarray:
    """Convert a column to numbers (K,), time stamps to seconds after the first."""
    kind = column.type
    if len(column) == 0:
        return np.empty(0)
    if arrow.types.is_timestamp(kind) or arrow.types.is_duration(kind):
        stamps = column.to_numpy().astype("timedelta64[ns]" if arrow.types.is_duration(kind)
                                          else "datetime64[ns]")  # fmt: skip
        seconds: np.ndarray = (stamps - stamps[0]) / np.timedelta64(1, "s")
        return seconds
    if not (arrow.types.is_integer(kind) or arrow.types.is_floating(kind)):
        hint = f" Name an entry: {name}[0]" if arrow.types.is_nested(kind) else ""
        raise InputFileError(path, name, f"needs a column of numbers, got {kind}.{hint}")
    return np.asarray(column.to_numpy(), dtype=float)


def _is_number(kind: arrow.DataType) -> bool:
    types = arrow.types
    stamp = types.is_timestamp(kind) or types.is_duration(kind)
    return bool(stamp or types.is_integer(kind) or types.is_floating(kind))


def _is_vector(kind: arrow.DataType) -> bool:
    types = arrow.types
    listed = types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)
    return bool(
        listed and (types.is_integer(kind.value_type) or types.is_floating(kind.value_type))
    )


def _vector_entries(path: Path, name: str, column: arrow.ChunkedArray) -> Table:
    """Return the entries of vectors of equal length; none for other columns."""
    length = len(column[0].as_py() or ()) if len(column) else 0
    if not 0 < length <= MAX_ENTRIES:
        return {}
    rows = column.to_pylist()
    if any(row is None or len(row) != length for row in rows):
        return {}
    names = vector_names(path, name)
    return expand_vectors(name, np.array(rows, dtype=float), names)


def vector_names(path: Path, feature: str) -> list[str]:
    """Names of the entries of a vector column in the file's dataset; empty where not given."""
    return _entry_names(_dataset_features(path).get(feature))


def _entry_names(feature: Any) -> list[str]:
    """Names of a feature's entries; some datasets nest them one level deeper."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    return [str(name) for name in names] if isinstance(names, list) else []


def _dataset_features(path: Path) -> dict[str, Any]:
    found = checks.find_dataset_info(path)
    document = {} if found is None else load_json(found)
    features = document.get("features") if isinstance(document, dict) else None
    return features if isinstance(features, dict) else {}
