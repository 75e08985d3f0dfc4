"""Samples that jump away from their neighbours and back."""

from __future__ import annotations

import numpy as np

_LONGEST = 2
# A spike in units of what nine of ten samples nearby, or in the whole run, depart by.
_NEARBY, _ANYWHERE = 6.0, 3.0
_COUNTS = 8.0
# A spike in units of the jump between the samples before it and after it.
_JUMP = 2.0
_FEWEST = 50
# Cubic through two samples on each side, at the sample between them.
_CUBIC = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0


def spikes(
    values: np.ndarray, step: float = 0.0, harmless: float = 0.0
) -> tuple[np.ndarray, float]:
    """Samples that no motion explains.

    Parameters
    ----------
    values : array (K,)
        nan is passed over.
    step : float
        Smallest step of the channel, 0 if it has none.
    harmless : float
        Jumps up to this size are left alone.

    Returns
    -------
    spikes : array (K,) of bool
    size : float
        Largest jump.

    Notes
    -----
    A spike lasts one or two samples and departs from the cubic through the two samples on each
    side by more than samples nearby do, and by twice as much as the two sides are apart once
    their slopes are followed. A step, as at a reversal or a contact, is none.
    """
    finite = np.flatnonzero(np.isfinite(values))
    bad = np.zeros(len(values), dtype=bool)
    if len(finite) < _FEWEST:
        return bad, 0.0
    series = values[finite]
    departs = np.zeros(len(series))
    departs[2:-2] = np.abs(series - np.convolve(series, _CUBIC, "same"))[2:-2]
    limit = np.maximum(
        np.maximum(_NEARBY * _nearby(departs), _ANYWHERE * float(np.quantile(departs, 0.9))),
        max(_COUNTS * step, harmless, 1e-12 * float(np.abs(series).max())),
    )
    # Two samples in a row depart by a third of their height.
    candidates = np.flatnonzero(departs > limit / 3.0)
    largest = 0.0
    for k in candidates[np.argsort(-departs[candidates])]:
        for first, last in _spans(int(k), len(series)):
            height = _height(series, first, last)
            if height > limit[k] and not bad[finite[first - 2 : last + 2]].any():
                bad[finite[first:last]] = True
                largest = max(largest, height)
    return bad, largest


def _spans(k: int, count: int) -> list[tuple[int, int]]:
    """Spikes that a sample may belong to, with two samples to spare on each side."""
    spans = [
        (first, first + length)
        for length in range(1, _LONGEST + 1)
        for first in range(k - length + 1, k + 1)
    ]
    return [(first, last) for first, last in spans if first >= 2 and last + 2 <= count]


def _height(series: np.ndarray, first: int, last: int) -> float:
    """How far a spike stands out of what is around it, 0 if the two sides disagree."""
    a, b, c, d = series[[first - 2, first - 1, last, last + 1]]
    at = np.arange(first, last) - (first - 1)
    width = last - first + 1
    # Hermite cubic between b and c with the slopes of both sides.
    s = at / width
    smooth = (
        (1 + 2 * s) * (1 - s) ** 2 * b
        + s * (1 - s) ** 2 * width * (b - a)
        + s**2 * (3 - 2 * s) * c
        - s**2 * (1 - s) * width * (d - c)
    )
    height = float(np.min(np.abs(series[first:last] - smooth)))
    apart = abs((c - b) - 0.5 * width * ((b - a) + (d - c)))
    return height if height > _JUMP * apart else 0.0


def _nearby(departs: np.ndarray, width: int = 51) -> np.ndarray:
    """Upper decile around each sample, by blocks."""
    count = -(-len(departs) // width)
    blocks = np.pad(departs, (0, count * width - len(departs)), mode="reflect")
    rank = int(0.9 * width)
    level = np.partition(blocks.reshape(count, width), rank, axis=1)[:, rank]
    # The louder of the block and its neighbours: a quiet block may border on a fast motion.
    wide = np.pad(level, 1, mode="edge")
    louder = np.maximum(level, np.maximum(wide[:-2], wide[2:]))
    return np.repeat(louder, width)[: len(departs)]
