"""Episodes of LeRobot datasets: Parquet files of vectors whose entries meta/info.json names."""

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
from stiffopt.recording.readers.checks import (
    check_columns,
    check_numbers,
    find_dataset_info,
    require_time,
    split_episode,
)
from stiffopt.recording.readers.parquet import column_to_numbers
from stiffopt.recording.signals import Signals

_ENTRY_PATTERN = re.compile(r"(.+)\[([^\]]+)\]")
_EPISODE_COLUMN = "episode_index"


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Read columns of one episode: "FILE.parquet#3" where the file holds more than one.

    A channel is a column, or an entry of a vector by number or by name:
    "observation.state[0]", "observation.state[shoulder_pan.pos]".
    """
    require_time(signals, path)
    file, episode = split_episode(path)
    wanted = (signals.time, *signals.wanted)
    entries = {name: _ENTRY_PATTERN.fullmatch(name) for name in wanted}
    needed = [name if match is None else match[1] for name, match in entries.items()]
    with parquet.ParquetFile(file) as source:
        there = source.schema_arrow.names
        check_columns(path, needed, there)
        check_numbers(path, source.metadata.num_rows, len(wanted))
        index = [_EPISODE_COLUMN] if _EPISODE_COLUMN in there else []
        table = source.read(columns=list(dict.fromkeys([*needed, *index])), use_threads=False)
    if index:
        table = _select_episode(path, table, episode)
    columns = {}
    for name, match in entries.items():
        if match is None:
            columns[name] = column_to_numbers(path, name, table.column(name))
        else:
            columns[name] = _vector_entry(
                path, table.column(match[1]), match[1], match[2], vector_names(file, match[1])
            )
    return columns


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
    found = find_dataset_info(path)
    document = {} if found is None else load_json(found)
    features = document.get("features") if isinstance(document, dict) else None
    return features if isinstance(features, dict) else {}
