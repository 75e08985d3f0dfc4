"""Tables of recordings: unnamed columns, the joint topic of message logs, garbled rows left out."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from stiffopt.errors import InputError, InputFileError
from stiffopt.recording.readers.columns import ENTRY_NAME_FIELDS, Table, is_unnamed
from stiffopt.recording.readers.messages import get_field
from stiffopt.recording.readers.read import MAX_MAGNITUDE, first_messages, read_columns
from stiffopt.recording.signals import Signals
from stiffopt.robot.robot import Robot
from stiffopt.starter.column_names import (
    TIME_WORDS,
    columns_of_kind,
    command_columns,
    order_by_joint,
    split_words,
)


def join_signal_files(tables: Mapping[Path, Table], robot: Robot) -> dict[Path, Table]:
    """Join tables of one signal each, with equally many rows, to one run; others are kept.

    Beside one table that is a run by itself, others are joined to it: commands beside states. The
    columns of a file are named after it, "tau[0]", in the order of the joints where their own names
    tell it; those of a file of several signals keep their names. The clock is that of the first
    file, or of the run. Raises `InputFileError`: together they are a run, but differ in their rows.
    """
    complete = [path for path, table in tables.items() if _is_complete(table, robot)]
    if len(complete) > 1 or len(tables) < 2:
        return dict(tables)
    lengths = {path: len(next(iter(table.values()))) for path, table in tables.items()}
    first = next(iter(complete or tables))
    other = next((path for path, rows in lengths.items() if rows != lengths[first]), None)
    if complete and other is not None:
        return dict(tables)
    joined: Table = dict(tables[first]) if complete else {}
    for path, table in tables.items():
        if path in complete:
            continue
        clock = _clock_columns(table, robot)
        signals = [name for name in table if name not in clock]
        for name in clock:
            joined.setdefault("t" if is_unnamed(table) else name, table[name])
        if len(signals) > robot.n and not is_unnamed(table):
            for name in signals:
                joined[f"{path.stem}.{name}" if name in joined else name] = table[name]
            continue
        ordered = order_by_joint(signals, robot.joint_names) if len(signals) == robot.n else None
        for k, name in enumerate(ordered or signals):
            joined[path.stem if len(signals) == 1 else f"{path.stem}[{k}]"] = table[name]
    if other is not None:
        if not _holds_position_and_cause(list(joined), robot):
            return dict(tables)
        raise InputFileError(
            other, "", f"has {lengths[other]} rows, {first.name} {lengths[first]}: files of one"
            " signal each are a run if they have equally many. Cut off the rows that one has more,"
            " or interpolate its signal at the times of the others."
        )  # fmt: skip
    return {first.parent / f"{first.parent.name}.npz": joined}


def _clock_columns(table: Table, robot: Robot) -> list[str]:
    """Return the columns of times; of columns without names, those before one a joint."""
    if is_unnamed(table):
        return list(table)[: len(table) % robot.n] if len(table) > 1 else []
    return [name for name in table if set(split_words(name)) & set(TIME_WORDS)]


def _is_complete(table: Table, robot: Robot) -> bool:
    """Return True for a table that is a run by itself."""
    unnamed = is_unnamed(table) and len(table) > robot.n + 1
    return unnamed or _holds_position_and_cause(list(table), robot)


def _holds_position_and_cause(names: list[str], robot: Robot) -> bool:
    """Return True for columns of positions, and torques or commands, of all joints."""
    position, torque = (
        columns_of_kind(names, kind, robot.joint_names) for kind in ("position", "torque")
    )
    return bool(position and (torque or command_columns(names, robot.joint_names)))


def name_blocks(table: Table, robot: Robot) -> tuple[Table, str]:
    """Name the columns of a table without names: a time, then blocks of one column a joint.

    Also return why, with a question where the values leave it open; "" for a file with names, whose
    table stays as it is. Raises `InputError` where no layout has so many columns.
    """
    if not is_unnamed(table):
        return table, ""
    columns, n = list(table.values()), robot.n
    timed = len(columns) % n == 1 if n > 1 else bool(np.all(np.diff(columns[0]) > 0.0))
    blocks = [np.column_stack(columns[k : k + n]) for k in range(timed, len(columns), n)]
    if len(blocks) < 2 or any(block.shape[1] != n for block in blocks):
        raise InputError(
            f"has {len(columns)} columns without names, which are no time and blocks of {n} joints."
            f" Give it one line of {len(columns)} column names, such as t, q1, q2, tau1, tau2,"
            " above the numbers."
        )
    names, reason = _guess_block_kinds(blocks)
    found: Table = {"t": columns[0]} if timed else {}
    for name, block in zip(names, blocks, strict=True):
        found |= {f"{name}[{j}]": block[:, j] for j in range(n)}
    order = ", ".join([*(["time"] if timed else []), *names])
    return found, f"the columns have no names; taken as {order}, {n} each: {reason}"


def _guess_block_kinds(blocks: list[np.ndarray]) -> tuple[list[str], str]:
    """Return the kinds of blocks (K, n) by which of them changes at the rate of another."""
    names = [""] * len(blocks)
    position = 0
    for k in range(len(blocks)):
        rate = next((m for m in range(len(blocks)) if _is_rate_of(blocks[m], blocks[k])), None)
        if rate is None:
            continue
        if "velocity" not in names:
            position, names[rate] = k, "velocity"
        elif not names[rate]:
            names[rate] = "acceleration"
    names[position] = "position"
    rest = [k for k, name in enumerate(names) if not name]
    for number, k in enumerate(rest):
        names[k] = "torque" if number == 0 else f"other {number}"
    if "velocity" in names and len(rest) == 1:
        return names, "the velocities are the positions' rate of change"
    return names, "QUESTION: is this their order? Else write their names above the numbers"


def _is_rate_of(rates: np.ndarray, values: np.ndarray) -> bool:
    """Return True if columns (K, n) correlate with the changes of others, joint by joint.

    Over several rows: loggers repeat some, or are late by a part of a row.
    """
    if rates is values:
        return False
    fits = []
    rows = max(len(values) // _RATE_STEPS, 1)
    for rate, value in zip(rates.T, values.T, strict=True):
        change = np.diff(value[::rows])
        mean = 0.5 * (rate[1:] + rate[:-1])[: rows * len(change)].reshape(-1, rows).mean(axis=1)
        known = np.isfinite(change) & np.isfinite(mean)
        if known.sum() > 2 and np.ptp(change[known]) > 0.0 and np.ptp(mean[known]) > 0.0:
            fits.append(float(spearmanr(change[known], mean[known]).statistic))
    # Least rank correlation of a velocity with the rate of change of its position. By ranks, a few
    # garbled rows of a logger do not matter.
    return bool(fits) and float(np.median(fits)) > 0.9


# Steps of a recording over which rates and changes are compared.
_RATE_STEPS = 1000
_VALUE_FIELDS = ("position", "velocity", "effort", "torque", "current", "positions", "velocities",
          "efforts", "accelerations", "q", "qd", "tau")  # fmt: skip
# Parts of controller messages with such lists, measured before commanded.
_MESSAGE_PARTS = ("", "actual", "feedback", "measured", "state")
STAMP_COLUMN = "stamp"


def read_message_table(path: Path, joints: Sequence[str]) -> dict[str, np.ndarray]:
    """Read the columns of the joint topic, under names such as "/js.position[elbow]".

    The stamps [s] are under `TIME`. Raises `InputFileError`: no topic has a number for each joint;
    lists the topics found.
    """
    found: dict[str, list[str]] = {}
    # Number of messages searched for topics.
    for topic, _, message in first_messages(path, 2000):
        # A gripper may publish on the topic of the arm.
        if not found.get(topic):
            found[topic] = _joint_fields(topic, message, joints)
    best = max(found, key=lambda topic: len(found[topic]), default="")
    if not found.get(best):
        raise InputFileError(
            path,
            "",
            f"no topic among {', '.join(sorted(found)[:20]) or 'none'} has lists of numbers for"
            f" the joints {', '.join(joints)}. Name its fields in [signals] of recordings.toml by"
            " hand.",
        )
    fields = found[best]
    signals = Signals(
        time=STAMP_COLUMN, position=tuple(fields), velocity=None, link_position=None, torque=()
    )
    return dict(read_columns(path, signals))


def _joint_fields(topic: str, message: Any, joints: Sequence[str]) -> list[str]:
    """Return the names of message fields with a number for each joint."""
    stated: Any = next(
        (n for key in ENTRY_NAME_FIELDS if (n := get_field(message, key)) is not None), ()
    )
    # A field called "name" need not list joints.
    listed = isinstance(stated, Sequence) and not isinstance(stated, str)
    names = list(stated) if listed and all(isinstance(n, str) for n in stated) else []
    named = set(joints) <= set(names)
    found: list[str] = []
    for part in _MESSAGE_PARTS:
        holder = get_field(message, part) if part else message
        for key in _VALUE_FIELDS:
            values = get_field(holder, key)
            if not isinstance(values, Sequence | np.ndarray) or isinstance(values, str):
                continue
            place = f"{topic}.{part}.{key}" if part else f"{topic}.{key}"
            if named and not part and len(values) == len(names):
                found += [f"{place}[{joint}]" for joint in joints]
            elif len(values) == len(joints) and not names:
                found += [f"{place}[{j}]" for j in range(len(joints))]
            elif named and len(values) == len(names):
                found += [f"{place}[{names.index(joint)}]" for joint in joints]
    return found


# Fewest rows of a piece between gaps of as many rows: no filter has settled on fewer.
_MIN_PIECE_ROWS = 20


def drop_garbled_rows(table: Table) -> tuple[Table, list[int]]:
    """Return a table without garbled rows, and the numbers of those, from 1.

    A row is garbled where a value exceeds any measurement, where its time stamp does not fit into
    the longest increasing sequence of stamps, or where few rows stand alone between long gaps;
    clocks that restart are left as they are.
    """
    senseless = np.zeros(len(next(iter(table.values()))), dtype=bool)
    for column in table.values():
        senseless |= np.isfinite(column) & (np.abs(column) > MAX_MAGNITUDE)
    kept = np.flatnonzero(~senseless)
    time = next((name for name in table if set(split_words(name)) & set(TIME_WORDS)), None)
    if time is not None:
        stamps = table[time][kept]
        ordered = kept
        if np.isfinite(stamps).all():
            ordered = kept[longest_increasing(stamps)]
            ordered = ordered[_outside_short_pieces(table[time][ordered])]
        # More rows out of order are no logger's fault, but another clock or order.
        if len(kept) - len(ordered) <= 0.01 * len(kept):
            kept = ordered
    dropped = np.setdiff1d(np.arange(len(senseless)), kept)
    if not len(dropped):
        return table, []
    return {name: column[kept] for name, column in table.items()}, (dropped + 1).tolist()


def _outside_short_pieces(stamps: np.ndarray) -> np.ndarray:
    """Return a mask of the stamps in pieces between gaps that are long enough to be used."""
    steps = np.diff(stamps)
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.inf
    piece = np.concatenate([[0], np.cumsum(steps > _MIN_PIECE_ROWS * usual)])
    return np.asarray(np.bincount(piece)[piece] >= _MIN_PIECE_ROWS)


def longest_increasing(values: np.ndarray) -> np.ndarray:
    """Return the indices of a longest nondecreasing subsequence."""
    if np.all(np.diff(values) >= 0.0):
        return np.arange(len(values))
    ends: list[float] = []  # least last value of a subsequence of each length
    last: list[int] = []
    before = np.full(len(values), -1)
    for index, value in enumerate(values.tolist()):
        length = bisect_right(ends, value)
        before[index] = last[length - 1] if length else -1
        ends[length : length + 1] = [value]
        last[length : length + 1] = [index]
    found = [last[-1]]
    while before[found[-1]] >= 0:
        found.append(int(before[found[-1]]))
    return np.array(found[::-1])
