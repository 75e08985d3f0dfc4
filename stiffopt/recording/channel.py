"""Statistics of one channel: smallest step and noise."""

from __future__ import annotations

import numpy as np

# Third differences of white noise have this many times its variance (1 + 9 + 9 + 1).
_THIRD = 20.0
# Standard deviation of a normal variable over its median distance from the median.
MAD = 1.4826


def resolution(values: np.ndarray) -> float | None:
    """Smallest step of a quantised channel, None if its values lie on no grid.

    Parameters
    ----------
    values : array (K,)
        nan is passed over.

    Notes
    -----
    Valid where neighbouring levels occur: of the spacings between the values that occur, 95 %
    must be whole multiples of the step within 5 %.
    """
    levels = np.unique(values[np.isfinite(values)])
    if len(levels) < 3:
        return None
    spacing = np.diff(levels)
    # Copies of one level that differ by rounding only.
    spacing = spacing[spacing > 1e-9 * np.abs(levels).max()]
    if len(spacing) < 2:
        return None
    smallest = float(np.quantile(spacing, 0.02))
    near = spacing[spacing < 1.5 * smallest]
    if not len(near):
        return None
    step = float(np.median(near))
    multiples = spacing / step
    error = np.abs(multiples - np.round(multiples))
    # Large multiples are whole numbers within 5 % by chance or not at all.
    small = multiples < 20.0
    if small.sum() < 2 or (error[small] < 0.05).mean() < 0.95:
        return None
    return step


def noise_level(values: np.ndarray) -> float:
    """Standard deviation of the white noise on an evenly sampled, slowly varying channel.

    Parameters
    ----------
    values : array (K,)
        In any unit; nan is passed over.

    Returns
    -------
    float
        In that unit; nan if there are too few samples.

    Notes
    -----
    From the median of third differences, which a smooth motion and single jumps hardly touch.
    Valid where the motion varies slowly against three sample times.
    """
    with np.errstate(invalid="ignore"):
        third = np.diff(values, 3)
    third = third[np.isfinite(third)]
    if len(third) < 10:
        return float("nan")
    spread = MAD * np.median(np.abs(third - np.median(third)))
    return float(spread / np.sqrt(_THIRD))
