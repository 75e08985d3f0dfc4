"""Channels that hold a value: stuck while the joint moves, or resting on a limit."""

from __future__ import annotations

import numpy as np

from stiffopt.recording.channel import resolution, stretches

_SHORTEST = 10
# A channel with fewer levels holds each of them for long.
_FEWEST_LEVELS = 50
# How rarely chance may hold a value that long in one run.
_CHANCE = 1e-6


def samples(values: np.ndarray, position: np.ndarray, still: float) -> np.ndarray:
    """Samples of stretches that hold one value while the joint moves.

    Parameters
    ----------
    values : array (K,)
        Any unit.
    position : array (K,)
        Of another sensor of the same joint [rad].
    still : float
        A stretch in which the joint travels less is not judged [rad].

    Returns
    -------
    array (K,) of bool

    Notes
    -----
    A stretch counts if it is longer than coarse counts alone would make it once in a million
    runs, given how often neighbouring samples are equal while the joint moves.
    """
    equal = np.diff(values) == 0.0
    found = np.zeros(len(values), dtype=bool)
    step = resolution(values) or 0.0
    span = float(np.nanmax(values) - np.nanmin(values))
    if not equal.any() or span < _FEWEST_LEVELS * step:
        return found
    held = stretches(equal)
    moving = np.diff(position) != 0.0
    usual = equal & moving
    for begin, end in held:
        if end - begin >= _SHORTEST:
            usual[begin:end] = False
    share = min(0.99, float(usual.sum()) / max(1, int(moving.sum())))
    chance = np.log(len(values) / _CHANCE) / -np.log(share) if share > 0.0 else 0.0
    shortest = max(_SHORTEST, chance)
    for begin, end in held:
        piece = position[begin : end + 1]
        if end - begin < shortest or not np.isfinite(piece).any():
            continue
        if np.nanmax(piece) - np.nanmin(piece) > still:
            # The first sample of a stretch was measured.
            found[begin + 1 : end + 1] = True
    return found


def at_limit(values: np.ndarray) -> np.ndarray:
    """Samples that rest on the largest or the smallest value of a channel.

    Parameters
    ----------
    values : array (K,)

    Returns
    -------
    array (K,) of bool

    Notes
    -----
    The peak of a smooth signal in coarse counts rests there too, but about as long on the level
    below; a limit is told by at least five samples in a row and five times as many as in the
    next hundredth of the range (or the next count, if that is coarser).
    """
    bad = np.zeros(len(values), dtype=bool)
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return bad
    span = float(finite.max() - finite.min())
    if span == 0.0:
        return bad
    step = max(resolution(values) or 0.0, 0.01 * span)
    for sign in (1.0, -1.0):
        height = sign * values
        top = np.nanmax(height)
        resting = height == top
        longest = max(end - begin for begin, end in stretches(resting))
        below = int(((height < top) & (height >= top - 1.01 * step)).sum())
        if longest >= 5 and resting.sum() > 5 * below:
            bad |= resting
    return bad
