"""Rows that a logger garbled: values beyond any measurement, stamps out of the clock's order."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from stiffopt.recording.readers.columns import Table
from stiffopt.recording.readers.read import MAX_MAGNITUDE
from stiffopt.starter.column_names import TIME_WORDS, split_words

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
