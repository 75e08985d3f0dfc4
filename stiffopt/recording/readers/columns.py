"""Columns of a table from nested content: dotted names, one column for each entry of a vector."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.recording.readers.checks import check_columns, check_numbers, require_time
from stiffopt.recording.readers.clocks import join_split_stamps, parse_stamps
from stiffopt.recording.signals import Signals

# Columns by name. Entry k of a vector is named "name[k]", a nested one "outer.name".
Table = dict[str, np.ndarray]

# Longest vector of joint signals; longer ones are images, point clouds or maps.
MAX_ENTRIES = 64
# Levels of nesting that are searched for signals.
_MAX_DEPTH = 12
# Fields of messages that name the entries of the lists beside them.
ENTRY_NAME_FIELDS = ("name", "names", "joint_names")
# Prefix of the names of columns that a file leaves without a name.
UNNAMED_COLUMN = "column"


def unnamed_columns(count: int) -> list[str]:
    """Return names "column 1", ... of columns that have none."""
    return [f"{UNNAMED_COLUMN} {k}" for k in range(1, count + 1)]


def is_unnamed(table: Iterable[str]) -> bool:
    """Return True if the file of a table names no column."""
    return all(name.rpartition(" ")[0] == UNNAMED_COLUMN for name in table)


def expand_vectors(name: str, rows: np.ndarray, entries: Sequence[str] = ()) -> Table:
    """Return one column for each entry of vectors (K, n); a single one keeps the name."""
    count = rows.shape[1]
    if count == 1:
        return {name: rows[:, 0]}
    called = entries if len(entries) == count else range(count)
    return {f"{name}[{entry}]": rows[:, k] for k, entry in enumerate(called)}


def columns_of_arrays(arrays: Mapping[str, Any]) -> Table:
    """Return the columns of the numeric arrays that have one row for each sample.

    The number of samples is the length that most arrays share, along either axis.
    """
    numeric = {name: own for name, each in arrays.items() if (own := _as_numeric(each)) is not None}
    lengths = Counter(max(each.shape) for each in numeric.values())
    # Of lengths that equally many arrays share, the largest is that of time.
    rows = max(lengths, key=lambda length: (lengths[length], length), default=0)
    table: Table = {}
    for name, each in numeric.items():
        two = each.reshape(-1, 1) if each.ndim == 1 else each
        two = two if len(two) == rows else two.T
        if len(two) == rows and two.shape[1] <= MAX_ENTRIES:
            table |= expand_vectors(name, two)
    return shorten_names(table)


def _as_numeric(value: Any) -> np.ndarray | None:
    """Return numbers as a float array of one or two axes; None for other content."""
    if isinstance(value, list | tuple) and value and isinstance(value[0], str):
        return parse_stamps([str(each) for each in value])
    try:
        array = np.asarray(value)
    except ValueError:  # rows of unequal length
        return None
    if array.ndim == 2 and 1 in array.shape:
        array = array.reshape(-1)
    if array.ndim not in (1, 2) or array.size < 2:
        return None
    if array.dtype == object:
        # None stands for a missing sample.
        try:
            array = array.astype(float)
        except (TypeError, ValueError):
            return None
    return array.astype(float) if array.dtype.kind in "fiub" else None


def shorten_names(table: Table) -> Table:
    """Drop the outer names that all columns share: "data.q[0]" and "data.t" to "q[0]" and "t"."""
    while table:
        outer = {name.partition(".")[0] for name in table}
        if len(outer) > 1 or not all("." in name.partition("[")[0] for name in table):
            break
        table = {name.partition(".")[2]: column for name, column in table.items()}
    return table


def columns_of_records(records: Iterable[Any], path: Path) -> Table:
    """Return the columns of records, one a sample; of several kinds, those of the commonest.

    A record is a mapping or a list. Lists that a field of names stands beside, as in messages of
    joint states, have their entries named: "position[elbow]".
    """
    rows = [dict(_flatten_record(record, "", 0)) for record in records]
    kinds = Counter(frozenset(row) for row in rows if row)
    if not kinds:
        return {}
    kind = max(kinds, key=lambda names: (kinds[names], len(names)))
    # Of records of the commonest kind; others lack fields (a gripper beside the arm).
    same = [row for row in rows if row.keys() >= kind]
    names = [name for name in same[0] if name in kind]
    check_numbers(path, len(same), len(names))
    table: Table = {}
    for name in names:
        cells = [row[name] for row in same]
        if any(isinstance(cell, str) for cell in cells):
            seconds = parse_stamps([str(cell) for cell in cells])
            if seconds is not None:
                table[name] = seconds
        else:
            table[name] = np.array(cells, dtype=float)
    return shorten_names(join_split_stamps(table))


def _flatten_record(value: Any, name: str, depth: int) -> Iterator[tuple[str, float | str]]:
    """Yield the numbers and texts of a record with their names; None is a missing number."""
    if depth > _MAX_DEPTH:
        return
    if isinstance(value, Mapping):
        said = next((each for key in ENTRY_NAME_FIELDS if (each := value.get(key))), ())
        entries = said if isinstance(said, list) and all(isinstance(n, str) for n in said) else ()
        for key, own in value.items():
            inner = f"{name}.{key}" if name else str(key)
            if isinstance(own, list) and own is not said and entries and len(own) == len(entries):
                for entry, each in zip(entries, own, strict=True):
                    yield from _flatten_record(each, f"{inner}[{entry}]", depth + 1)
            else:
                yield from _flatten_record(own, inner, depth + 1)
    elif isinstance(value, list | tuple):
        if len(value) <= MAX_ENTRIES:
            for k, own in enumerate(value):
                yield from _flatten_record(own, f"{name}[{k}]", depth + 1)
    elif value is None:
        yield name, float("nan")
    elif isinstance(value, str):
        yield name, value
    elif isinstance(value, int | float | np.number):
        yield name, _to_float(value)


def _to_float(value: int | float | np.number) -> float:
    try:
        return float(value)
    except OverflowError:  # an integer beyond any float
        return float("inf")


def flatten_mapping(content: Any, name: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield the leaves of nested mappings with dotted names."""
    if isinstance(content, Mapping):
        if depth <= _MAX_DEPTH:
            for key, own in content.items():
                yield from flatten_mapping(own, f"{name}.{key}" if name else str(key), depth + 1)
    else:
        yield name, content


def select_columns(path: Path, table: Mapping[str, np.ndarray], signals: Signals) -> Table:
    """Return the columns that `signals` names; raise `InputFileError` for a missing one."""
    require_time(signals, path)
    wanted = (signals.time, *signals.wanted)
    check_columns(path, wanted, table)
    return {name: np.asarray(table[name], dtype=float) for name in wanted}
