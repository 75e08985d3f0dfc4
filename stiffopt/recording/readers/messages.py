"""Channels from recorded messages: fields by topic, time stamps, resampling to one clock."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputFileError, nearest
from stiffopt.recording.readers.checks import check_messages, check_numbers
from stiffopt.recording.readers.columns import ENTRY_NAME_FIELDS
from stiffopt.recording.signals import Signals

# Topic, log time [ns], decoded message.
Message = tuple[str, int, Any]

_STEP_PATTERN = re.compile(r"\.?([^.\[\]]+)|\[([^\]]+)\]")
# Stamps [s] and [ns] that 64 bits of nanoseconds can hold.
_MAX_STAMP = 4e9


@dataclass(frozen=True)
class Field:
    """A number inside the messages of a topic, such as "/joint_states.position[elbow]"."""

    topic: str
    # Attributes; an entry of a list by number, or by name as "[elbow]".
    steps: tuple[str | int, ...]

    def of(self, message: Any) -> float | None:
        """Return the number in a message, None where it is missing."""
        value, holder = message, message
        for step in self.steps:
            if isinstance(step, str) and step.startswith("["):
                names = next(
                    (n for key in ENTRY_NAME_FIELDS if (n := get_field(holder, key)) is not None),
                    (),
                )
                if not isinstance(names, Sequence) or step[1:-1] not in names:
                    return None
                step = list(names).index(step[1:-1])
            if isinstance(step, int):
                if not isinstance(value, Sequence | np.ndarray) or step >= len(value):
                    return None
                value = value[step]
                continue
            holder, value = value, get_field(value, step)
            if value is None:
                return None
        return _as_float(value)


@dataclass
class _Topic:
    fields: dict[str, Field] = field(default_factory=dict)
    stamps: list[int] = field(default_factory=list)
    logged: list[int] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)
    seen: set[str] = field(default_factory=set)

    def add(self, log_time: int, message: Any) -> None:
        values = {name: one.of(message) for name, one in self.fields.items()}
        row = [value for value in values.values() if value is not None]
        # Several nodes may publish on one topic: ignore messages without the fields.
        if len(row) == len(values):
            self.logged.append(log_time)
            self.stamps.append(_header_stamp(message))
            self.rows.append(row)
        elif not self.rows:
            self.seen |= {name for name, value in values.items() if value is not None}

    @property
    def clock(self) -> np.ndarray:
        """Stamps [ns]: of the headers if all messages have one, else of the log."""
        return np.array(self.stamps if all(self.stamps) else self.logged, dtype=np.int64)


def parse_field(name: str, topics: Iterable[str], path: Path) -> Field:
    """Parse a channel name into topic and field.

    Raises `InputFileError`: no such topic, or no field after it.
    """
    known = list(topics)
    fitting = [topic for topic in known if name == topic or name.startswith(f"{topic}.")]
    if not fitting:
        topic = re.split(r"[.\[]", name)[0]
        raise InputFileError(
            path, "", f"has no topic {topic!r}, which [signals] names. {nearest(topic, known)}"
        )
    topic = max(fitting, key=len)
    steps: list[str | int] = []
    for attribute, entry in _STEP_PATTERN.findall(name[len(topic) :]):
        if attribute:
            steps.append(attribute)
        else:
            steps.append(int(entry) if entry.isdigit() else f"[{entry}]")
    if not steps:
        raise InputFileError(
            path, "", f"{name!r} names no field. Write it as {topic}.position[0] or "
            f"{topic}.position[elbow]."
        )  # fmt: skip
    return Field(topic, tuple(steps))


def gather_columns(
    path: Path, signals: Signals, topics: Iterable[str], messages: Iterable[Message]
) -> dict[str, np.ndarray]:
    """Collect the columns (R,) that `signals` names from messages in the order of the log.

    On the clock of the topic of the first position, in seconds after its first stamp. Channels of
    other topics are interpolated linearly, NaN outside of their stamps.
    """
    wanted = {name: parse_field(name, topics, path) for name in signals.wanted}
    own: dict[str, _Topic] = {}
    for name, one in wanted.items():
        own.setdefault(one.topic, _Topic()).fields[name] = one
    base = wanted[signals.position[0]].topic
    timed = any(
        signals.time.startswith(f"{topic}.") and ".stamp" not in signals.time for topic in topics
    )
    if timed:
        one = parse_field(signals.time, topics, path)
        if one.topic != base:
            raise InputFileError(path, "", f"signals.time must be a field of {base}.")
        own[base].fields[signals.time] = one
    for count, (topic, log_time, message) in enumerate(messages):
        check_messages(path, count)
        if topic in own:
            own[topic].add(log_time, message)
            check_numbers(path, len(own[topic].rows), len(own[topic].fields))
    columns = _topic_columns(path, own, base)
    if not timed:
        clock = own[base].clock
        columns[signals.time] = (clock - clock[0]) / 1e9
    return columns


def wanted_topics(signals: Signals, topics: Sequence[str], path: Path) -> set[str]:
    """Topics of the channels of `signals`."""
    return {parse_field(name, topics, path).topic for name in signals.wanted}


def _topic_columns(path: Path, own: Mapping[str, _Topic], base: str) -> dict[str, np.ndarray]:
    columns: dict[str, np.ndarray] = {}
    for topic, held in own.items():
        if not held.rows:
            lacking = [name for name in held.fields if name not in held.seen] or list(held.fields)
            raise InputFileError(
                path,
                "",
                f"no message on {topic} has {', '.join(lacking)}. Correct the names, or leave "
                'them out of [signals] ("").',
            )
        for name, column in zip(held.fields, np.array(held.rows).T, strict=True):
            columns[name] = (
                column if topic == base else _resample_to_clock(own[base].clock, held.clock, column)
            )
    return columns


def _resample_to_clock(clock: np.ndarray, other: np.ndarray, values: np.ndarray) -> np.ndarray:
    order = np.argsort(other, kind="stable")
    begin = min(int(clock[0]), int(other[order[0]]))
    at, known = clock - begin, (other - begin)[order]
    aligned: np.ndarray = np.interp(at, known, values[order], left=np.nan, right=np.nan)
    return aligned


def get_field(value: Any, key: str) -> Any:
    """Field of a message of any library; None where it is missing."""
    return value.get(key) if isinstance(value, Mapping) else getattr(value, key, None)


def _header_stamp(message: Any) -> int:
    """Stamp of the header [ns], 0 without one."""
    stamp = get_field(get_field(message, "header"), "stamp")
    seconds = _as_float(get_field(stamp, "sec"))
    rest = next((r for key in ("nanosec", "nsec") if (r := get_field(stamp, key)) is not None), 0)
    nanoseconds = _as_float(rest)
    if seconds is None or not abs(seconds) < _MAX_STAMP or not abs(nanoseconds or 0.0) < _MAX_STAMP:
        return 0
    return 10**9 * int(seconds) + int(nanoseconds or 0.0)


def _as_float(value: Any) -> float | None:
    """Convert a number to float, None for other content of a message."""
    if not isinstance(value, int | float | np.number):
        return None
    # Integers of JSON may exceed the range of a float.
    if isinstance(value, int) and abs(value) > 1e15:
        return float(np.inf)
    return float(value)
