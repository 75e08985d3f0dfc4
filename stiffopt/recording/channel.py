"""Statistics of one channel: resolution, noise; stuck, saturated and outlying samples."""

from __future__ import annotations

import numpy as np

# Variance of third differences of white noise over its variance (1 + 9 + 9 + 1).
_THIRD_DIFFERENCE_VARIANCE = 20.0
# Standard deviation of a normal variable over its median absolute deviation (MAD).
DEVIATION_PER_MAD = 1.4826


def resolution(values: np.ndarray) -> float | None:
    """Smallest step of a quantised channel, None if its values lie on no grid.

    `values` (K,): NaN is ignored. Valid where neighbouring levels occur: of the spacings between
    the values that occur, 95 % must be whole multiples of the step within 5 %.
    """
    levels = np.unique(values[np.isfinite(values)])
    if len(levels) < 3:
        return None
    spacing = np.diff(levels)
    # Ignore levels that differ by rounding only.
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
    # Large multiples are whole numbers within 5 % by chance.
    small = multiples < 20.0
    if small.sum() < 2 or (error[small] < 0.05).mean() < 0.95:
        return None
    return step


def noise_level(values: np.ndarray) -> float:
    """Standard deviation of the white noise on an evenly sampled, slowly varying channel (K,).

    From the median of third differences, which a smooth motion and single jumps hardly touch; nan
    if there are too few samples. NaN is ignored.
    """
    with np.errstate(invalid="ignore"):
        third = np.diff(values, 3)
    third = third[np.isfinite(third)]
    if len(third) < 10:
        return float("nan")
    spread = DEVIATION_PER_MAD * np.median(np.abs(third - np.median(third)))
    return float(spread / np.sqrt(_THIRD_DIFFERENCE_VARIANCE))


# Shortest interval of one value that may count as stuck [samples].
_MIN_STUCK_SAMPLES = 10
# A channel with fewer levels holds each of them for long without being stuck.
_MIN_LEVELS = 50
# Probability that coarse quantisation holds a value that long in one run.
_MAX_FALSE_ALARM_RATE = 1e-6
# Length of a spike [samples].
_MAX_SPIKE_SAMPLES = 2
# Jump at the end of a stuck interval over the travel of the other sensor during it.
_MIN_JUMP_SHARE = 0.5
# Wind-up while the motor is stationary over that in the rest of the run.
_MAX_WINDUP_RATIO = 2.0
# Least height of a spike over the upper decile of departures nearby, and in the whole run.
_LOCAL_SPIKE_RATIO, _GLOBAL_SPIKE_RATIO = 6.0, 3.0
_MIN_SPIKE_COUNTS = 8.0
# Least height of a spike over the step between the samples before and after it.
_MIN_SPIKE_STEP_RATIO = 2.0
_MIN_SAMPLES = 50
# Cubic through two samples on each side, at the sample between them.
_CUBIC_WEIGHTS = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0


def true_intervals(marked: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of every interval of True in an array (K,) of bool."""
    edges = np.diff(np.concatenate(([0], marked.astype(int), [0])))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(int(begin), int(end)) for begin, end in zip(begins, ends, strict=True)]


def find_stuck_samples(
    values: np.ndarray, position: np.ndarray, still: float, step: float
) -> np.ndarray:
    """Mark samples of intervals that hold one value while the joint moves.

    An interval counts if the joint travels more than `still` [rad] by another sensor's `position`,
    and it is longer than coarse quantisation (`step`, 0 for none) would produce once in a million
    runs, given how often neighbouring samples are equal while the joint moves.
    """
    equal = np.diff(values) == 0.0
    found = np.zeros(len(values), dtype=bool)
    span = float(np.nanmax(values) - np.nanmin(values))
    if not equal.any() or span < _MIN_LEVELS * step:
        return found
    held = true_intervals(equal)
    moving = np.diff(position) != 0.0
    usual = equal & moving
    for begin, end in held:
        if end - begin >= _MIN_STUCK_SAMPLES:
            usual[begin:end] = False
    share = min(0.99, float(usual.sum()) / max(1, int(moving.sum())))
    chance = np.log(len(values) / _MAX_FALSE_ALARM_RATE) / -np.log(share) if share > 0.0 else 0.0
    shortest = max(_MIN_STUCK_SAMPLES, chance)
    for begin, end in held:
        piece = position[begin : end + 1]
        if end - begin < shortest or not np.isfinite(piece).any():
            continue
        if np.nanmax(piece) - np.nanmin(piece) > still:
            # The first sample of an interval was measured.
            found[begin + 1 : end + 1] = True
    return found


def is_held_by_friction(values: np.ndarray, link: np.ndarray, begin: int, end: int) -> bool:
    """Return whether friction held the motor while its link moved on: the encoder is not stuck.

    A motor starts from rest; a stuck encoder recovers with a jump over the motion that it missed.
    One that loses counts, or does not recover, departs from the link by far more than the joint
    winds up elsewhere in the run. `values` is constant from `begin` to before `end`.
    """
    apart = values - link
    outside = (_finite_range(apart[:begin]), _finite_range(apart[end:]))
    if _finite_range(apart[begin:end]) > _MAX_WINDUP_RATIO * max(outside):
        return False
    jump = abs(values[end] - values[end - 1]) if end < len(values) else 0.0
    return bool(jump < _MIN_JUMP_SHARE * _finite_range(link[begin:end]))


def _finite_range(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.ptp(known)) if known.size else 0.0


def are_whole(values: np.ndarray) -> bool:
    """Return True where all finite values are whole numbers, of which there are some."""
    known = values[np.isfinite(values)]
    return bool(known.size and np.all(known == np.round(known)))


def are_magnitudes(values: np.ndarray) -> bool:
    """Return True for columns (K, n) without a sign: none is below zero, each that changes is zero.

    A torque that never changes its direction does not end at zero.
    """
    changing = np.flatnonzero([_finite_range(column) > 0.0 for column in values.T])
    return bool(len(changing)) and bool(np.all(np.nanmin(values[:, changing], axis=0) == 0.0))


# Levels of a channel below which it rests on its largest value by rounding alone.
_MIN_LIMITED_LEVELS = 8


def find_saturated_samples(values: np.ndarray, step: float) -> np.ndarray:
    """Mark samples saturated at the largest or the smallest value of a channel.

    The peak of a smooth signal, quantised coarsely by `step`, has about as many samples on the
    level below; a limit has at least five samples in a row and five times as many as the next
    hundredth of the range (or the next count, if that is coarser). Few levels are noise at rest.
    """
    bad = np.zeros(len(values), dtype=bool)
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return bad
    if len(np.unique(finite)) < _MIN_LIMITED_LEVELS:
        return bad
    near = max(step, 0.01 * float(finite.max() - finite.min()))
    for sign in (1.0, -1.0):
        height = sign * values
        top = np.nanmax(height)
        resting = height == top
        longest = max(end - begin for begin, end in true_intervals(resting))
        below = int(((height < top) & (height >= top - 1.01 * near)).sum())
        if longest >= 5 and resting.sum() > 5 * below:
            bad |= resting
    return bad


def find_spikes(
    values: np.ndarray, step: float = 0.0, harmless: float = 0.0
) -> tuple[np.ndarray, float]:
    """Mark samples that jump away from their neighbours and back; return the largest jump.

    A spike lasts one or two samples and departs from the cubic through the two samples on each side
    by more than samples nearby do, and by twice as much as the two sides differ after extrapolation
    with their slopes. A step, as at a reversal or a contact, is no spike. Jumps up to `harmless`
    and NaN are ignored; `step` is the smallest of the channel, 0 if it has none.
    """
    finite = np.flatnonzero(np.isfinite(values))
    bad = np.zeros(len(values), dtype=bool)
    if len(finite) < _MIN_SAMPLES:
        return bad, 0.0
    series = values[finite]
    departs = np.zeros(len(series))
    departs[2:-2] = np.abs(series - np.convolve(series, _CUBIC_WEIGHTS, "same"))[2:-2]
    limit = np.maximum(
        np.maximum(
            _LOCAL_SPIKE_RATIO * _local_upper_decile(departs),
            _GLOBAL_SPIKE_RATIO * float(np.quantile(departs, 0.9)),
        ),
        max(_MIN_SPIKE_COUNTS * step, harmless, 1e-12 * float(np.abs(series).max())),
    )
    # Two samples in a row depart by a third of their height.
    candidates = np.flatnonzero(departs > limit / 3.0)
    largest = 0.0
    for k in candidates[np.argsort(-departs[candidates])]:
        for first, last in _candidate_spans(int(k), len(series)):
            height = _spike_height(series, first, last)
            if height > limit[k] and not bad[finite[first - 2 : last + 2]].any():
                bad[finite[first:last]] = True
                largest = max(largest, height)
    return bad, largest


def _candidate_spans(k: int, count: int) -> list[tuple[int, int]]:
    """Intervals of spikes that a sample may belong to, with two samples on each side."""
    spans = [
        (first, first + length)
        for length in range(1, _MAX_SPIKE_SAMPLES + 1)
        for first in range(k - length + 1, k + 1)
    ]
    return [(first, last) for first, last in spans if first >= 2 and last + 2 <= count]


def _spike_height(series: np.ndarray, first: int, last: int) -> float:
    """Height of a spike over the interpolated signal; 0 if the two sides disagree."""
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
    return height if height > _MIN_SPIKE_STEP_RATIO * apart else 0.0


def _local_upper_decile(departs: np.ndarray, width: int = 51) -> np.ndarray:
    """Upper decile around each sample, by blocks."""
    count = -(-len(departs) // width)
    blocks = np.pad(departs, (0, count * width - len(departs)), mode="reflect")
    rank = int(0.9 * width)
    level = np.partition(blocks.reshape(count, width), rank, axis=1)[:, rank]
    # Largest of the block and its neighbours: a quiet block may border on a fast motion.
    wide = np.pad(level, 1, mode="edge")
    louder = np.maximum(level, np.maximum(wide[:-2], wide[2:]))
    return np.repeat(louder, width)[: len(departs)]
