"""Cleaning of the raw columns of a run file: clock, repeated rows, faulty channels."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from stiffopt.recording.channel import noise_level, resolution, true_intervals
from stiffopt.recording.channel_faults import JointChannels, check_joint_channels, covered_range
from stiffopt.recording.clock import (
    Clock,
    clock_fault,
    holds_rest_poses,
    read_clock,
    read_pose_rows,
    without_jitter,
)
from stiffopt.recording.run import Fault, RecordedRun, Role, counted
from stiffopt.recording.signals import KINDS, Kind, Signals

# Motion over repeated rows over its extrapolation by the speeds around, and the reciprocal.
_MAX_MOTION_RATIO = 1.5
# Rows that a slowly sampled channel holds one value; speeds are taken over as many.
_MAX_HELD_ROWS = 3
# Counts below which a step is no motion.
_MIN_STEP_COUNTS = 4.0


def clean_run(
    columns: Mapping[str, np.ndarray],
    signals: Signals,
    *,
    path: Path,
    name: str,
    file: str,
    role: Role,
    session_time: float | None = None,
    number: int = 0,
    temperature: np.ndarray | None = None,
    prismatic: np.ndarray | None = None,
) -> RecordedRun:
    """Check the clock and every channel, report faults and remove faulty samples.

    `columns` (R,). `path`: of the file, for messages. `name`, `file`, `role`, `session_time`,
    `number` and `temperature`: as in `RecordedRun`. `prismatic` (n,).
    Raises `InputFileError`: a clock that cannot be used.
    """
    n = len(signals.position)
    build_run = partial(
        RecordedRun,
        name=name,
        file=file,
        role=role,
        session_time=session_time,
        number=number,
        temperature=temperature,
    )
    if holds_rest_poses(columns, signals):
        stamps, rows = read_pose_rows(columns, signals, path)
        position, links, torque = (
            _stack_channels(columns, signals, kind, rows)
            for kind in ("position", "link_position", "torque")
        )
        assert position is not None
        assert torque is not None
        return build_run(
            stamps=stamps,
            time=stamps[rows],
            position=position,
            velocity=None,
            link_position=links,
            torque=torque,
            faults=(),
            at_rest=True,
        )
    clock = read_clock(columns[signals.time], path, signals.time)
    recorded = clock.stamps
    clock = without_jitter(clock, np.column_stack([columns[name] for name in signals.position]))
    rows, stale = _remove_repeated_rows(columns, signals, clock)
    time = clock.stamps[rows]
    faults = [*clock.faults, *stale]
    arrays = {
        kind: None if signals.of(kind) is None else np.full((len(rows), n), np.nan)
        for kind in KINDS
    }
    for j in range(n):
        channels = {
            kind: columns[column][rows].copy() for kind, k, column in signals.columns() if k == j
        }
        joint = JointChannels(
            joint=j,
            time=time,
            channels=channels,
            prismatic=bool(prismatic is not None and prismatic[j]),
        )
        # A command is no measurement: it may stand still, jump and be coarse.
        command = channels.pop("command", None)
        faults += check_joint_channels(joint)
        if command is not None:
            channels["command"] = command
        for kind, values in channels.items():
            array = arrays[kind]
            if array is not None:
                array[:, j] = values
    position, torque = arrays["position"], arrays["torque"]
    assert position is not None
    assert torque is not None
    return build_run(
        stamps=clock.stamps,
        recorded_stamps=recorded,
        time=time,
        position=position,
        velocity=_none_if_empty(arrays["velocity"]),
        link_position=_none_if_empty(arrays["link_position"]),
        torque=torque,
        faults=tuple(faults),
        command=_none_if_empty(arrays["command"]),
    )


def _stack_channels(
    columns: Mapping[str, np.ndarray], signals: Signals, kind: Kind, rows: np.ndarray
) -> np.ndarray | None:
    """Return the channels (K, n) of one kind at some rows; None if no joint has that signal."""
    array = np.full((len(rows), len(signals.position)), np.nan)
    for own, joint, column in signals.columns():
        if own == kind:
            array[:, joint] = columns[column][rows]
    return _none_if_empty(array)


def _none_if_empty(array: np.ndarray | None) -> np.ndarray | None:
    return array if array is not None and np.isfinite(array).any() else None


def _remove_repeated_rows(
    columns: Mapping[str, np.ndarray], signals: Signals, clock: Clock
) -> tuple[np.ndarray, list[Fault]]:
    """Remove rows that repeat the motion of the row before under a new stamp.

    Only where the arm moved meanwhile; equal rows at rest are kept. Torque must be repeated too
    where rows are equal for longer than a slowly sampled channel holds one value.
    """
    rows = clock.rows
    named = [(kind, columns[column][rows]) for kind, _, column in signals.columns()]
    positions = np.column_stack([values for kind, values in named if kind == "position"])
    motion = _mark_repeated_rows([values for kind, values in named if kind != "torque"])
    frozen = _mark_repeated_rows([values for _, values in named])
    zero = np.all([values == 0.0 for _, values in named], axis=0)
    ride = _MotionExtrapolation(clock.stamps[rows], positions, motion)
    copies, empty = np.zeros(len(rows), dtype=bool), np.zeros(len(rows), dtype=bool)
    for begin, end in true_intervals(zero):
        empty[begin:end] = ride.left(begin, end)
    for begin, end in true_intervals(motion & ~zero):
        known = end - begin <= _MAX_HELD_ROWS or frozen[begin:end].all()
        copies[begin:end] = known and ride.went_on(begin, end)
    faults = [
        clock_fault(
            "duplicate",
            f"{cause} {counted(int(marked.sum()), 'row')}, left out.",
            float(marked.mean()),
        )
        for cause, marked in (
            ("the motion of the row before is repeated in", copies),
            ("all channels read 0, as where nothing was received, in", empty),
        )
        if marked.any()
    ]
    return rows[~copies & ~empty], faults


def _mark_repeated_rows(channels: list[np.ndarray]) -> np.ndarray:
    """Mark rows (K,) in which all channels, each (K,), equal the row before."""
    same = np.ones(len(channels[0]), dtype=bool)
    same[0] = False
    for values in channels:
        absent = np.isnan(values)
        same[1:] &= (values[1:] == values[:-1]) | (absent[1:] & absent[:-1])
    return same


class _MotionExtrapolation:
    """Extrapolation of the arm's motion over rows that repeat or omit it.

    `time` (K,) [s]. `positions` (K, n). `same` (K,): rows that repeat the motion of the row before.
    """

    def __init__(self, time: np.ndarray, positions: np.ndarray, same: np.ndarray) -> None:
        self._time = time
        self._positions = np.where(np.isfinite(positions), positions, np.nan)
        self._new_rows = np.flatnonzero(~same)
        self._thresholds = np.array(
            [_MIN_STEP_COUNTS * _change_threshold(values) for values in positions.T]
        )

    def went_on(self, begin: int, end: int) -> bool:
        """Return whether a joint moved over rows `begin` to `end` as it did before and after."""
        if begin == 0 or end >= len(self._time):
            return False
        speeds, gap, step = self._surrounding_motion(begin, end)
        least, most = np.sort(np.abs(speeds), axis=0) * gap
        size, way = np.abs(step), np.sign(step)
        fits = (size > least / _MAX_MOTION_RATIO - self._thresholds) & (
            size < most * _MAX_MOTION_RATIO + self._thresholds
        )
        alike = np.all(np.sign(speeds) == way, axis=0) & (size > self._thresholds)
        return bool(np.any(fits & alike))

    def left(self, begin: int, end: int) -> bool:
        """Return whether a joint jumps at row `begin` and back at `end` to its extrapolation."""
        if begin == 0 or end >= len(self._time):
            return False
        speeds, gap, step = self._surrounding_motion(begin, end)
        most = np.abs(speeds).max(axis=0)
        usual = np.median(np.diff(self._time))
        leap = _MAX_HELD_ROWS * most * usual + self._thresholds
        there = np.abs(self._positions[begin] - self._positions[begin - 1]) > leap
        back = np.abs(self._positions[end] - self._positions[end - 1]) > leap
        return bool(
            np.any(
                there & back & (np.abs(step) < _MAX_MOTION_RATIO * most * gap + self._thresholds)
            )
        )

    def _surrounding_motion(self, begin: int, end: int) -> tuple[np.ndarray, float, np.ndarray]:
        """Speeds (2, n) before and after, time between [s] and step (n,) of the positions."""
        speeds = np.stack([self._speed_near(begin - 1, -1), self._speed_near(end, 1)])
        gap = float(self._time[end] - self._time[begin - 1])
        return speeds, gap, self._positions[end] - self._positions[begin - 1]

    def _speed_near(self, row: int, way: int) -> np.ndarray:
        """Speeds (n,) over the rows before (-1) or after (1) a row; 0 where the arm is at rest."""
        place = int(np.searchsorted(self._new_rows, row))
        last = row
        while 0 <= place + way < len(self._new_rows) and abs(last - row) < _MAX_HELD_ROWS:
            place += way
            if abs(int(self._new_rows[place]) - last) > _MAX_HELD_ROWS + 1:
                break
            last = int(self._new_rows[place])
        if last == row:
            return np.zeros(self._positions.shape[1])
        moved = self._positions[last] - self._positions[row]
        return np.asarray(moved / (self._time[last] - self._time[row]))


def _change_threshold(values: np.ndarray) -> float:
    """Change of a channel (K,) below which it is a count or noise."""
    least = resolution(values) or 1e-9 * covered_range(values)
    return float(np.fmax(least, 3.0 * noise_level(values)))
