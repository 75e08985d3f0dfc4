"""Clock of a run: usable samples, gaps, dropped samples, jitter; poses at rest, which have none.

Where a logger stamps samples as they arrive, the stamps jitter and the samples do not. Over stamps
that are not the instants of its samples a motion is rough.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from stiffopt.errors import InputFileError
from stiffopt.recording.run import Fault, FaultKind, counted
from stiffopt.recording.signals import Signals

# Spacing of a gap, across which signals are not interpolated [sample times].
MIN_GAP_STEPS = 5.0
# Spacing from which samples are missing [sample times].
_MIN_DROPPED_STEPS = 1.7
# Deviation from the usual spacing that counts as jitter [sample times].
_MAX_JITTER = 0.05
# Rows over which jitter averages out. Roughness of a motion over even stamps, relative to that over
# its own, below which it was sampled evenly: of real arms .02 to .2 where it was, 3 to 8 where not.
_JITTER_ROWS, _MAX_ROUGHNESS = 51, 0.7
# Instants of an even clock per recorded sample; beyond, the run is mostly gaps or its clock jumped,
# and memory grows with the even clock.
MAX_GRID_RATIO = 20.0
# Instants that every run may have: half an hour at 500 Hz.
MIN_GRID = 1_000_000
# Samples of a run, and spacing above which no motion is resolved [s].
_MIN_SAMPLES = 20
MAX_MOTION_STEP = 0.5
# Drives sample at 1 MHz at most, and a log lasts longer than 1 ms [s].
_MIN_STEP, _MIN_DURATION = 1e-6, 1e-3


@dataclass(frozen=True, eq=False)
class Clock:
    """Time stamps of a run."""

    stamps: np.ndarray  # (R,) of all rows of the file [s]
    rows: np.ndarray  # (K,) rows that are kept; their stamps increase strictly
    step: float  # usual spacing [s]
    faults: tuple[Fault, ...]


def read_clock(stamps: np.ndarray, path: Path, column: str) -> Clock:
    """Check the time stamps of a run.

    Raises `InputFileError`: time decreases or is constant, samples are too few, or the unit cannot
    be seconds.
    """
    where = column or "stamps"
    finite = np.flatnonzero(np.isfinite(stamps))
    if len(finite) < _MIN_SAMPLES:
        raise InputFileError(
            path, where, f"has {len(finite)} time stamps; a run needs {_MIN_SAMPLES} or more."
        )
    spacing = np.diff(stamps[finite])
    back = np.flatnonzero(spacing < 0.0)
    if len(back):
        row = int(finite[back[0] + 1])
        raise InputFileError(
            path,
            f"{where}, row {row + 1}",
            f"time runs backwards {counted(len(back), 'time')}, first "
            f"from {stamps[finite[back[0]]]:.6f} s to {stamps[row]:.6f} s. "
            "Cut the file there, or write it in the order of time.",
        )
    rows = finite[np.concatenate(([True], spacing > 0.0))]
    if len(rows) < _MIN_SAMPLES:
        raise InputFileError(
            path,
            where,
            f"holds only {len(rows)} different times in {len(stamps)} rows; "
            f"a run needs {_MIN_SAMPLES}.",
        )
    spacing = np.diff(stamps[rows])
    step = float(np.median(spacing))
    if step > MAX_MOTION_STEP:
        raise InputFileError(
            path,
            where,
            f"its usual spacing is {step:g}; in seconds that is too slow to hold a motion "
            f"(allowed: up to {MAX_MOTION_STEP:g} s). Convert the column to seconds; of a table "
            "with one pose at rest a row, say at_rest = true in [signals].",
        )
    if step < _MIN_STEP or stamps[rows[-1]] - stamps[rows[0]] < _MIN_DURATION:
        raise InputFileError(
            path,
            where,
            f"its usual spacing is {step:g} and all of it {stamps[rows[-1]] - stamps[rows[0]]:g};"
            f" in seconds that is no motion of a robot (allowed: from {_MIN_STEP:g} s a sample"
            f" and {_MIN_DURATION:g} s in all). Convert the column to seconds, or say its unit in"
            " signals.scale.time.",
        )
    _check_grid(spacing, step, rows, path, where)
    faults = [*_lost_stamp_faults(stamps, finite, rows), *_spacing_faults(spacing, step)]
    return Clock(_fill_stamps(stamps, finite), rows, step, tuple(faults))


def without_jitter(clock: Clock, positions: np.ndarray) -> Clock:
    """Return the clock with even stamps where positions (R, n) are smoother over these."""
    if not any(fault.kind == "jitter" for fault in clock.faults):
        return clock
    stamps, own = clock.stamps[clock.rows], positions[clock.rows]
    even = _even_stamps(stamps, clock.step)
    if not (np.diff(even) > 0.0).all():
        return clock
    over_even, over_own = (_roughness(each, own, clock.step) for each in (even, stamps))
    moved = over_own > 0.0
    if not moved.any() or np.median(over_even[moved] / over_own[moved]) > _MAX_ROUGHNESS:
        return clock
    text = (
        f"the stamps jitter (standard deviation {1e3 * float(np.std(stamps - even)):.2g} ms), the"
        " samples do not: positions are smoother over even stamps, which are used."
    )
    faults = (replace(f, detail=text) if f.kind == "jitter" else f for f in clock.faults)
    every = np.interp(np.arange(len(clock.stamps)), clock.rows, even)
    return replace(clock, stamps=every, faults=tuple(faults))


def _even_stamps(stamps: np.ndarray, step: float) -> np.ndarray:
    """Return stamps (K,) that follow the rows, up to gaps, lost samples and a changing rate."""
    found = []
    for own in np.split(stamps, np.flatnonzero(np.diff(stamps) > MIN_GAP_STEPS * step) + 1):
        spacing = np.diff(own) / step
        lost = np.where(spacing > _MIN_DROPPED_STEPS, np.round(spacing), 1.0)
        row, count = np.append(0.0, np.cumsum(lost)), min(_JITTER_ROWS, len(own))
        along = np.polyval(np.polyfit(row, own, min(1, count - 1)), row)
        steps = median_filter(own - along, count, mode="nearest")
        found.append(along + uniform_filter1d(steps, count, mode="nearest"))
    return np.concatenate(found)


def _roughness(stamps: np.ndarray, positions: np.ndarray, step: float) -> np.ndarray:
    """Return the usual third divided difference (n,) while joints move; nan if one never does."""
    orders = [positions]
    for k in (1, 2, 3):
        orders.append(np.diff(orders[-1], axis=0) / (stamps[k:] - stamps[:-k])[:, None])
    speed, third = np.nan_to_num(np.abs(orders[1][1:-1])), np.abs(orders[3])
    inside = (stamps[3:] - stamps[:-3] < MIN_GAP_STEPS * step)[:, None] & np.isfinite(third)
    used = inside & (speed > speed.mean(axis=0))
    pairs = zip(third.T, used.T, strict=True)
    return np.array([np.median(own[rows]) if rows.any() else np.nan for own, rows in pairs])


def _check_grid(spacing: np.ndarray, step: float, rows: np.ndarray, path: Path, where: str) -> None:
    """Raise `InputFileError` where an even clock would have far more samples than were recorded."""
    samples = float(spacing.sum()) / step
    if samples > max(MAX_GRID_RATIO * len(rows), MIN_GRID):
        longest = int(np.argmax(spacing))
        row = int(rows[longest + 1]) + 1
        raise InputFileError(
            path,
            f"{where}, row {row}",
            f"time goes on by {spacing[longest]:.6g} s there, and {len(rows)} samples every "
            f"{step:.3g} s are spread over {spacing.sum():.6g} s. Cut the file into runs where"
            " nothing was recorded, or mend its clock.",
        )


def clock_fault(kind: FaultKind, detail: str, share: float) -> Fault:
    """Return a fault of the rows of a run."""
    return Fault(
        signal="time",
        joint=None,
        kind=kind,
        detail=detail,
        left_out=False,
        share=share,
    )


def _lost_stamp_faults(stamps: np.ndarray, finite: np.ndarray, rows: np.ndarray) -> list[Fault]:
    faults = []
    absent, repeated = len(stamps) - len(finite), len(finite) - len(rows)
    if absent:
        share = absent / len(stamps)
        faults.append(
            clock_fault("not finite", f"no stamp in {counted(absent, 'row')}, left out.", share)
        )
    if repeated:
        share = repeated / len(stamps)
        text = f"the stamp before is repeated in {counted(repeated, 'row')}, left out."
        faults.append(clock_fault("duplicate", text, share))
    return faults


def _spacing_faults(spacing: np.ndarray, step: float) -> list[Fault]:
    faults = []
    ratio = spacing / step
    gaps = ratio > MIN_GAP_STEPS
    if gaps.any():
        text = (
            f"{counted(int(gaps.sum()), 'gap')} longer than {MIN_GAP_STEPS:g} sample times, the "
            f"longest {spacing.max():.3g} s; signals are not interpolated across them."
        )
        faults.append(clock_fault("gap", text, float(spacing[gaps].sum() / spacing.sum())))
    dropped = ~gaps & (ratio > _MIN_DROPPED_STEPS)
    if dropped.any():
        count = int(np.round(ratio[dropped] - 1.0).sum())
        text = (
            f"about {counted(count, 'sample')} lost in waits of up to "
            f"{1e3 * spacing[dropped].max():.3g} ms."
        )
        faults.append(clock_fault("dropped", text, count / (count + len(spacing) + 1)))
    rest = spacing[~gaps & ~dropped]
    uneven = np.abs(rest / step - 1.0) > _MAX_JITTER
    if uneven.any():
        text = (
            f"the spacing varies from {1e3 * rest.min():.3g} to {1e3 * rest.max():.3g} ms around "
            f"{1e3 * step:.3g} ms (standard deviation {1e3 * rest.std():.2g} ms); "
            "resampled before it is differentiated."
        )
        faults.append(clock_fault("jitter", text, float(uneven.mean())))
    return faults


def _fill_stamps(stamps: np.ndarray, finite: np.ndarray) -> np.ndarray:
    """Stamps with absent ones interpolated by row, since predictions need a time at every row."""
    if len(finite) == len(stamps):
        return stamps
    filled: np.ndarray = np.interp(np.arange(len(stamps)), finite, stamps[finite])
    return filled


# Fewer poses do not separate weight from friction at all.
MIN_POSES = 6


def holds_rest_poses(columns: Mapping[str, np.ndarray], signals: Signals) -> bool:
    """Return True for a table of poses, as for gravity compensation: as stated, else by its rows.

    Time numbers the poses; nothing moves from row to row, so that torques hold the weight and
    friction of unknown direction.

    Rows are poses where their spacing is too long for a motion in seconds and positions do not
    follow one another.
    """
    if not any(signals.torque):
        return False  # of commands alone, poses tell nothing
    if signals.at_rest is not None:
        return signals.at_rest
    if signals.time not in columns:
        return False
    steps = np.diff(columns[signals.time])
    steps = steps[np.isfinite(steps)]
    if not steps.size or not float(np.median(steps)) > MAX_MOTION_STEP:
        return False
    positions = np.column_stack([columns[name] for name in signals.position])
    return are_unordered(positions)


def are_unordered(positions: np.ndarray) -> bool:
    """Return True if rows of positions (K, n), in any unit, do not follow one another."""
    positions = positions[np.isfinite(positions).all(axis=1)]
    if len(positions) < MIN_POSES:
        return False
    spread = 2.0 * positions.var(axis=0)
    moved = np.mean(np.diff(positions, axis=0) ** 2, axis=0)
    turned = spread > 0.0
    # Mean square step over twice the variance (von Neumann's ratio over 2) of poses in no order: 1.
    # A motion sampled often enough to be followed has less than a tenth.
    return bool(turned.any() and np.median(moved[turned] / spread[turned]) > 0.3)


def read_pose_rows(
    columns: Mapping[str, np.ndarray], signals: Signals, path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of all rows (R,) and the rows (K,) with a complete position.

    Raises `InputFileError`: too few poses.
    """
    positions = np.column_stack([columns[name] for name in signals.position])
    rows = np.flatnonzero(np.isfinite(positions).all(axis=1))
    if len(rows) < MIN_POSES:
        raise InputFileError(
            path,
            "",
            f"holds {len(rows)} poses at rest; weight is separated from friction from {MIN_POSES}"
            " poses on, well from 50. Record more poses, or put several files into one.",
        )
    return np.arange(len(positions), dtype=float), rows
