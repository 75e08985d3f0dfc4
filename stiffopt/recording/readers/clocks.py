"""Time columns other than seconds: dates, times of day, seconds with nanoseconds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime, timedelta

import numpy as np

_DATE_PATTERN = re.compile(r"^(\d{1,2})[./-](\d{1,2})[./-](\d{4})\b")
_HALF_DAY_PATTERN = re.compile(r"\s*([ap])\.?m\.?$", re.IGNORECASE)
# Minutes and seconds as spreadsheets show them; hours and minutes have no decimals.
_MINUTES_PATTERN = re.compile(r"^(\d{1,3}):(\d{2}\.\d*)$")
# Periods after which clocks restart [s]; those with a date never do.
_DAY_PERIOD, _HOUR_PERIOD, _NO_PERIOD = 86400.0, 3600.0, float("inf")
_SECOND_WORDS = ("s", "sec", "secs", "second", "seconds")
_NANOSECOND_WORDS = ("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds")
_MICROSECOND_WORDS = ("us", "usec", "usecs", "microsec", "microseconds")


def parse_stamps(cells: list[str]) -> np.ndarray | None:
    """Return seconds since the first date or time of day; None if the cells are neither.

    Of dates with day or month first, the reading with the shorter span is used. Times of day
    restart at midnight, minutes and seconds every hour.
    """
    readings = [
        seconds
        for day_first in (True, False)
        if (seconds := _elapsed_seconds([_parse_stamp(cell, day_first) for cell in cells]))
        is not None
    ]
    return min(
        readings, key=lambda seconds: float(np.nanmax(seconds) - np.nanmin(seconds)), default=None
    )


def _elapsed_seconds(found: list[tuple[datetime, float] | None]) -> np.ndarray | None:
    """Return seconds since the first of (stamp, restart period) pairs, unwrapped."""
    known = [stamp for stamp in found if stamp is not None]
    if not known or len(known) < 0.9 * len(found):
        return None
    first, period = known[0]
    seconds = np.array([np.nan if s is None else (s[0] - first).total_seconds() for s in found])
    if period < _NO_PERIOD:
        there = np.isfinite(seconds)
        own = seconds[there]
        seconds[there] = own + period * np.cumsum(np.diff(own, prepend=own[0]) < -0.5 * period)
    return seconds


def _parse_stamp(cell: str, day_first: bool) -> tuple[datetime, float] | None:
    """Return date and time of a cell, and the restart period of such a clock [s]."""
    text = cell.strip().replace(",", ".")
    minutes = _MINUTES_PATTERN.match(text)
    if minutes is not None:
        passed = timedelta(minutes=int(minutes[1]), seconds=float(minutes[2]))
        return datetime(2000, 1, 1) + passed, _HOUR_PERIOD
    half = _HALF_DAY_PATTERN.search(text)
    if half is not None:
        text = text[: half.start()]
    date = _DATE_PATTERN.match(text)
    if date is not None:
        one, two, year = date.groups()
        day, month = (one, two) if day_first else (two, one)
        text = f"{year}-{int(month):02}-{int(day):02}{text[date.end() :]}"
    # ISO 8601 has two-digit hours; Python reads no digits beyond microseconds.
    text = re.sub(r"(^|[ T])(\d):", r"\g<1>0\2:", text)
    text = re.sub(r"(\.\d{6})\d+", r"\1", text)
    for form, period in ((text, _NO_PERIOD), (f"2000-01-01 {text}", _DAY_PERIOD)):
        try:
            stamp = datetime.fromisoformat(form).replace(tzinfo=None)
        except ValueError:
            continue
        if half is None:
            return stamp, period
        if not 1 <= stamp.hour <= 12:
            return None
        late = half[1].lower() == "p"
        return stamp + timedelta(hours=12 * (late - (stamp.hour == 12))), period
    return None


def join_split_stamps(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Join columns of whole seconds and their fraction, as in ROS stamps, to one of seconds.

    "header.stamp.sec" and "header.stamp.nanosec" become "header.stamp", counted from the first.
    """
    found = dict(columns)
    split = {name: re.split(r"[._/\s:]+", name.strip().lower()) for name in columns}
    for name, words in split.items():
        if words[-1] not in _SECOND_WORDS:
            continue
        for kinds, factor in ((_NANOSECOND_WORDS, 1e-9), (_MICROSECOND_WORDS, 1e-6)):
            rest = [n for n, w in split.items() if w[:-1] == words[:-1] and w[-1] in kinds]
            if len(rest) != 1 or len(columns[rest[0]]) != len(columns[name]):
                continue
            if not _is_fraction(columns[rest[0]], factor):
                continue
            whole = columns[name]
            cut = name.strip()[: -len(words[-1])].rstrip("._/ :") or "stamp"
            joined = whole - whole[0] + factor * columns[rest[0]]
            found = {cut: joined} | {n: v for n, v in found.items() if n not in (name, rest[0])}
    return found


def _is_fraction(values: np.ndarray, factor: float) -> bool:
    """Return True if all values are fractions of a second."""
    known = values[np.isfinite(values)]
    return known.size > 0 and bool(np.all((known >= 0.0) & (factor * known < 1.0)))
