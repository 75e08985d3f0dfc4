"""Samples that jump away from their neighbours and back."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from stiffopt.recording.channel import stretches

# Half window of the median: wider than the spikes that are sought, short against the motion.
_HALF = 3
_LONGEST = 2
_TIMES = 12.0
_COUNTS = 8.0


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
    A spike lasts one or two samples and leaves the median of the seven samples around it by more
    than twelve times as much as samples nearby do. A step, as at a reversal or a contact, moves
    the median along and is none.
    """
    finite = np.flatnonzero(np.isfinite(values))
    bad = np.zeros(len(values), dtype=bool)
    if len(finite) < 50:
        return bad, 0.0
    series = values[finite]
    padded = np.pad(series, _HALF, mode="edge")
    residual = np.abs(series - np.median(sliding_window_view(padded, 2 * _HALF + 1), axis=1))
    # Nearby: mean over half a hundred samples, without the largest few that a spike adds.
    nearby = _local_level(residual)
    quiet = float(np.quantile(residual, 0.9))
    limit = np.maximum(_TIMES * nearby, np.maximum(_TIMES * quiet / 3.0, _COUNTS * step))
    limit = np.maximum(limit, max(harmless, 1e-12 * float(np.abs(series).max())))
    far = residual > limit
    inside = np.zeros_like(far)
    for begin, end in stretches(far):
        if end - begin <= _LONGEST and begin > 0 and end < len(series):
            inside[begin:end] = _returns(series, begin, end, float(limit[begin]))
    bad[finite[inside]] = True
    return bad, float(residual[inside].max()) if inside.any() else 0.0


def _local_level(residual: np.ndarray, width: int = 51) -> np.ndarray:
    """Upper decile of the residual around each sample, by blocks."""
    count = max(1, len(residual) // width)
    blocks = np.array_split(residual, count)
    level = np.array([np.quantile(block, 0.9) for block in blocks])
    # The louder of the block and its neighbours: a quiet block may border on a fast motion.
    wide = np.pad(level, 1, mode="edge")
    louder = np.maximum(level, np.maximum(wide[:-2], wide[2:]))
    return np.repeat(louder, [len(block) for block in blocks])


def _returns(series: np.ndarray, begin: int, end: int, limit: float) -> bool:
    """Whether the samples on both sides agree with each other, but not with those between."""
    before, after = series[begin - 1], series[end]
    inside = series[begin:end]
    away = float(np.min(np.abs(inside - 0.5 * (before + after))))
    return bool(away > 2.0 * abs(after - before) and away > limit)
