"""A run on a uniform clock, in pieces between gaps, with a mask of what was really measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.recording.channel import stretches
from stiffopt.recording.clock import GAP
from stiffopt.recording.run import Role, Run
from stiffopt.recording.signals import KINDS

# A clock whose stamps lie this close to a uniform one, in sample times, is taken as uniform.
_EVEN = 0.02
# In sample times of the run: a uniform sample farther from all measured ones is not counted.
_NEAR = 0.8
_SHORTEST = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class UniformRun:
    """A run at constant rate.

    Parameters
    ----------
    name : str
    role : str
    session_time : float or None
        [s]
    temperature : array (n,) or None
        [degC]
    rate : float
        [Hz]
    time : array (K,)
        Multiples of 1 / rate after the first stamp; a segment continues the same clock [s].
    segments : tuple of slice
        Pieces without gaps; differentiate and filter within one.
    position : array (K, n)
        Finite wherever the joint has a position at all [rad].
    velocity, link_position : array (K, n) or None
        [rad/s], [rad]
    torque : array (K, n)
        [N m]
    position_valid, torque_valid : array (K, n) of bool
        Near a measured sample; elsewhere the value is interpolated and must not be fitted to.
    velocity_valid, link_position_valid : array (K, n) of bool or None
    interpolated : bool
        False if the clock of the run was uniform and its samples are used as they are.

    Notes
    -----
    A column of nan is a signal that the joint lacks.
    """

    name: str
    role: Role
    session_time: float | None
    temperature: np.ndarray | None
    rate: float
    time: np.ndarray
    segments: tuple[slice, ...]
    position: np.ndarray
    velocity: np.ndarray | None
    link_position: np.ndarray | None
    torque: np.ndarray
    position_valid: np.ndarray
    velocity_valid: np.ndarray | None
    link_position_valid: np.ndarray | None
    torque_valid: np.ndarray
    interpolated: bool

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.position.shape[1])

    @property
    def step(self) -> float:
        """Spacing of the samples [s]."""
        return 1.0 / self.rate

    def at(self, stamps: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values given on this clock, at other times: (K,) or (K, m) -> (R,) or (R, m).

        Linear between samples, across gaps too; constant beyond the ends.
        """
        columns = values.reshape(len(self.time), -1).T
        taken = np.column_stack([np.interp(stamps, self.time, column) for column in columns])
        return taken.reshape(len(stamps), *values.shape[1:])


def uniform(run: Run, rate: float | None = None) -> UniformRun:
    """Run on a uniform clock.

    Parameters
    ----------
    run : Run
    rate : float, optional
        [Hz]; default that of the run's usual spacing. A lower rate folds what the run holds above
        half of it: filter afterwards at the run's own rate instead.

    Returns
    -------
    UniformRun

    Raises
    ------
    ProblemError
        No piece without gaps has eight samples, or a joint has no position.

    Notes
    -----
    Cubic splines through the measured samples; linear where a channel has holes longer than a
    gap. Rows are split where the position of any joint has a gap longer than five sample times.
    """
    if not run.usable:
        lacking = [j + 1 for j in range(run.n) if not np.isfinite(run.position[:, j]).any()]
        raise ProblemError(
            f"{run.file}: joints {lacking} have no usable position, without which no torque can "
            f"be predicted. Leave the run out. {_faults(run)}"
        )
    rate = 1.0 / usual_step(run.time) if rate is None else rate
    grid, even = _grid(run, rate)
    pieces = _pieces(run)
    keep, segments = _place(grid, pieces, 1.0 / rate)
    if not segments:
        raise ProblemError(
            f"{run.file}: no piece between gaps has {_SHORTEST} samples. Leave the run out."
        )
    time = grid[keep]
    fields: dict[str, Any] = {}
    for kind in KINDS:
        array = run.signal(kind)
        if array is None:
            fields[kind] = fields[f"{kind}_valid"] = None
            continue
        values, valid = _resampled(run, array, time, segments, even)
        fields[kind], fields[f"{kind}_valid"] = values, valid
    return UniformRun(
        name=run.name,
        role=run.role,
        session_time=run.session_time,
        temperature=run.temperature,
        rate=rate,
        time=time,
        segments=tuple(segments),
        interpolated=not even,
        **fields,
    )


def usual_step(time: np.ndarray) -> float:
    """Spacing of a clock (K,) [s]: the median, or over a nearly even clock the exact mean."""
    spacing = np.diff(time)
    median = float(np.median(spacing))
    counts = np.round(spacing / median)
    if np.abs(spacing / median - counts).max() < 0.05:
        return float(spacing.sum() / counts.sum())
    return median


def _faults(run: Run) -> str:
    return " ".join(str(fault) for fault in run.health if fault.signal == "position")


def _grid(run: Run, rate: float) -> tuple[np.ndarray, bool]:
    """Uniform stamps over the run, and whether the run's own stamps are among them."""
    start = run.time[0]
    places = (run.time - start) * rate
    slots = np.round(places)
    even = bool((np.abs(places - slots) < _EVEN).all() and (np.diff(slots) > 0.0).all())
    count = int(slots[-1] if even else np.floor(places[-1] + 1e-6)) + 1
    return start + np.arange(count) / rate, even


def _pieces(run: Run) -> list[tuple[float, float]]:
    """Begin and end of the pieces in which all joints have positions without a gap [s]."""
    there = np.isfinite(run.position)
    rows = np.flatnonzero(there.all(axis=1))
    if not len(rows):
        return []
    time = run.time[rows]
    breaks = np.flatnonzero(np.diff(time) > GAP * run.step)
    begins = np.concatenate(([0], breaks + 1))
    ends = np.concatenate((breaks, [len(time) - 1]))
    return [(float(time[b]), float(time[e])) for b, e in zip(begins, ends, strict=True)]


def _place(
    grid: np.ndarray, pieces: list[tuple[float, float]], step: float
) -> tuple[np.ndarray, list[slice]]:
    """Indices of the grid inside pieces, and the slices of the pieces among them."""
    kept, segments, begin = [], [], 0
    slack = _EVEN * step
    for first, last in pieces:
        inside = np.flatnonzero((grid >= first - slack) & (grid <= last + slack))
        if len(inside) < _SHORTEST:
            continue
        kept.append(inside)
        segments.append(slice(begin, begin + len(inside)))
        begin += len(inside)
    return (np.concatenate(kept) if kept else np.zeros(0, dtype=int)), segments


def _resampled(
    run: Run, array: np.ndarray, time: np.ndarray, segments: list[slice], even: bool
) -> tuple[np.ndarray, np.ndarray]:
    values = np.full((len(time), run.n), np.nan)
    valid = np.zeros((len(time), run.n), dtype=bool)
    reach = _NEAR * run.step
    for j in range(run.n):
        there = np.isfinite(array[:, j])
        if not there.any():
            continue
        known, series = run.time[there], array[there, j]
        for segment in segments:
            at = time[segment]
            nearest = _nearest(known, at)
            far = np.abs(known[nearest] - at)
            valid[segment, j] = far <= reach
            if even:
                exact = far <= _EVEN * run.step
                values[segment, j] = np.where(
                    exact, series[nearest], _interpolate(known, series, at, run.step)
                )
            else:
                values[segment, j] = _interpolate(known, series, at, run.step)
    return values, valid


def _nearest(known: np.ndarray, at: np.ndarray) -> np.ndarray:
    right = np.clip(np.searchsorted(known, at), 1, len(known) - 1)
    nearer: np.ndarray = right - (at - known[right - 1] < known[right] - at)
    return nearer


def _interpolate(known: np.ndarray, series: np.ndarray, at: np.ndarray, step: float) -> np.ndarray:
    """Cubic spline inside stretches of known samples, linear across long holes."""
    from scipy.interpolate import CubicSpline

    values: np.ndarray = np.interp(at, known, series)
    for begin, end in stretches(np.diff(known) <= GAP * step):
        first, last = begin, end + 1
        inside = (at >= known[first]) & (at <= known[last - 1])
        if last - first >= 4 and inside.any():
            spline = CubicSpline(known[first:last], series[first:last])
            values[inside] = spline(at[inside])
    return values
