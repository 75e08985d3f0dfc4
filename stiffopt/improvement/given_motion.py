"""Given timed motions of joints: as a controller interpolates them, smoothed, and their path."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.errors import ProblemError
from stiffopt.improvement.least_jerk import least_jerk_motion
from stiffopt.problem.pose_following import fit_joint_path
from stiffopt.recording.channel import DEVIATION_PER_MAD, true_intervals
from stiffopt.result.joint_path import JointPath
from stiffopt.result.trajectory import JointMotion, Trajectory

# Rows closer together [s] are samples; further apart they are points that the controller joins.
_LONGEST_SAMPLE_INTERVAL = 0.012
# Knot spacing of the spline that smooths a motion: of samples, in intervals, and at least [s].
_SMOOTHED_INTERVALS, _MIN_SPACING = 4.0, 0.01
# Widest spacing of samples [s], and the residual of a wider one over that of the narrowest, beyond
# the resolution of a sample [rad], at which it still follows the motion.
_MAX_SPACING, _MAX_NOISE_RATIO, _SAMPLE_RESOLUTION = 0.16, 1.2, 2e-7
# Range of a joint at rest over the standard deviation of its noise, beside the path's tolerance.
_REST_NOISES = 5.0
# Window in which the speed at the ends is taken [s]; motions of fewer rows are points to pass.
_END_WINDOW, _MIN_JUDGED_ROWS = 0.02, 20
# Speed at the ends over the largest one from which a motion does not begin or end at rest.
_MAX_END_SHARE = 0.2
# Share of the mean speed that a motion may always have: it rises from rest without the noise there.
_LEAST_SPEED_SHARE = 0.02
# Window within whose range joints are at rest [s], and the interval at which it is moved.
_MIN_DWELL, _REST_INTERVAL = 0.1, 1e-3
# Change of a value from row to row less that by the mean of its rates, over that by the change of
# its rates, below which the rates are its derivatives: up to 0.03 if so, 0.3 and more if measured.
_MAX_RATE_ERROR = 0.1
# Joint deviation of the path from the smoothed motion [rad] or [m]: 10 um at 1 m.
_PATH_TOLERANCE = 1e-5
# Least number of instants at which arc length is integrated.
_MIN_ARC_SAMPLES = 4001


class GivenMotion:
    """Motion through given rows, as a controller interpolates it, in rest before and after.

    `time` (K,): from 0 [s]. `position`, `velocity` and `acceleration` (K, n): of degree 5 between
    rows with accelerations, cubic between rows with velocities; else, and of samples, a cubic
    spline. Between samples of a plan with accelerations the jerk keeps its limit `jerk_max` (n,),
    where a motion through them does.
    """

    def __init__(
        self,
        time: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray | None = None,
        acceleration: np.ndarray | None = None,
        jerk_max: np.ndarray | None = None,
    ) -> None:
        self.times = np.asarray(time, dtype=float)
        self._rows = (position, velocity, acceleration)
        self._jerk_max = jerk_max
        exact = velocity is not None and are_derivatives(velocity, self.times, position)
        self._has_noise = self.is_sampled and not exact
        self._spline: Callable[..., np.ndarray]
        if velocity is not None and acceleration is not None:
            rows = np.stack([position, velocity, acceleration], axis=1)
            limit = np.full(rows.shape[2], np.inf)
            if jerk_max is not None and self.is_sampled and not self._has_noise:
                limit = jerk_max
            self._spline = least_jerk_motion(self.times, rows, limit)
        # Of cubics between samples the acceleration jumps, in planned ones hardly, but in no time.
        elif velocity is None or self.is_sampled:
            self._spline = CubicSpline(self.times, position, bc_type="clamped")
        else:
            self._spline = CubicHermiteSpline(self.times, position, velocity)

    def check_ends(self) -> None:
        """Raise `ProblemError` for a motion that begins or ends in flight."""
        if len(self.times) < _MIN_JUDGED_ROWS:
            return
        # Over a window: differences of neighbouring samples are noise.
        grid = np.linspace(0.0, self.duration, int(self.duration / _END_WINDOW) + 2)
        moved = np.abs(np.diff(self(grid), axis=0))
        for name, row in (("begins", 0), ("ends", -1)):
            j = int(np.argmax(moved[row]))
            if moved[row, j] > _MAX_END_SHARE * moved.max():
                raise ProblemError(
                    f"the motion {name} while joint {j + 1} moves at "
                    f"{moved[row, j] / grid[1]:.3g} rad/s. Give the motion from rest to rest."
                )

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        return float(self.times[-1])

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Evaluate position (order 0) or a derivative at times (K,), shape (K, n)."""
        return np.asarray(self._spline(np.clip(t, 0.0, self.duration), order))

    @property
    def is_sampled(self) -> bool:
        """True for rows so close together that a controller does not join them."""
        return float(np.median(np.diff(self.times))) <= _LONGEST_SAMPLE_INTERVAL

    @cached_property
    def smoothed(self) -> Trajectory:
        """Nearest motion with continuous jerk, from rest to rest.

        Of samples the smoothest one that leaves hardly more than their noise.
        """
        interval = float(np.median(np.diff(self.times)))
        if not self.is_sampled:
            return smooth_motion(self, max(0.25 * interval, _MIN_SPACING))
        spacing = max(_SMOOTHED_INTERVALS * interval, _MIN_SPACING)
        found = smooth_motion(self, spacing)
        allowed = _MAX_NOISE_RATIO * self._rms_residual(found) + _SAMPLE_RESOLUTION
        while 2.0 * spacing <= _MAX_SPACING:
            spacing *= 2.0
            smoother = smooth_motion(self, spacing)
            if self._rms_residual(smoother) > allowed:
                break
            found = smoother
        return found

    def _rms_residual(self, motion: JointMotion) -> float:
        return float(np.sqrt(np.mean((motion(self.times) - self(self.times)) ** 2)))

    @cached_property
    def plan(self) -> Trajectory:
        """Given motion where it is planned as samples with their rates, else the smoothed one."""
        if self._has_noise or not self.is_sampled:
            return self.smoothed
        if isinstance(self._spline, Trajectory):
            return self._spline
        rows = [self._spline(self.times[:-1], k) / (k - 1) for k in (2, 3)]
        start, rest = self._spline(0.0), self._spline(0.0, 1)
        return Trajectory.from_acceleration(self.times, np.stack(rows, axis=1), start, rest)

    @cached_property
    def rests(self) -> list[tuple[float, float]]:
        """Begin and end of each rest [s], about whose instants no joint moves beyond its noise.

        A rest ends half a window before a joint leaves it: a motion rises slowly out of noise.
        Without those in which an arm creeps from one place to another.
        """
        count = max(_MIN_ARC_SAMPLES, int(np.ceil(self.duration / _REST_INTERVAL)) + 1)
        time = np.linspace(0.0, self.duration, count)
        position = self.plan(time)
        band = np.full(position.shape[1], _PATH_TOLERANCE)
        if self._has_noise:
            off = np.abs(self.smoothed(self.times) - self(self.times))
            # The median counts no misfit at bends.
            band += _REST_NOISES * DEVIATION_PER_MAD * np.median(off, axis=0)
        half = int(np.ceil(0.5 * _MIN_DWELL / time[1]))
        reach = maximum_filter1d(position, 2 * half + 1, axis=0)
        reach -= minimum_filter1d(position, 2 * half + 1, axis=0)
        still = (reach <= band).all(axis=1)
        # Windows that reach beyond the ends are no whole ones.
        still[:half], still[count - half :] = still[half], still[count - half - 1]
        runs = [(a, b - 1) for a, b in true_intervals(still) if b - 1 > a]
        same = [(np.abs(position[b] - position[a]) <= band).all() for a, b in runs]
        return [(float(time[a]), float(time[b])) for a, b in itertools.compress(runs, same)]

    def without_rest(self) -> tuple[GivenMotion, float, float]:
        """Return the motion without rest before and after it, and those two rests [s].

        It starts and ends at the mean places of those rests. Raises `ProblemError` if nothing
        moves, or the motion begins or ends in flight.
        """
        times, rests = self.times, self.rests
        first, last, position = 0, len(times) - 1, np.array(self._rows[0], dtype=float)
        if rests and rests[0][0] == 0.0:
            first = int(np.searchsorted(times, rests[0][1], "right")) - 1
            position[first] = position[: first + 1].mean(axis=0)
        if rests and rests[-1][1] == self.duration:
            last = int(np.searchsorted(times, rests[-1][0]))
            position[last] = position[last:].mean(axis=0)
        if first >= last:
            raise ProblemError(
                "the motion holds an arm at rest: no joint moves beyond its noise. Give one in "
                "which a joint moves."
            )
        kept = slice(first, last + 1)
        velocity, acceleration = (None if each is None else each[kept] for each in self._rows[1:])
        cut = GivenMotion(
            times[kept] - times[first], position[kept], velocity, acceleration, self._jerk_max
        )
        cut.check_ends()
        return cut, float(times[first]), float(times[-1] - times[last])

    @property
    def without_noise(self) -> JointMotion:
        """Given motion without the noise of samples, which planned ones with velocities lack."""
        return self.smoothed if self._has_noise else self


def are_derivatives(rate: np.ndarray, time: np.ndarray, value: np.ndarray) -> bool:
    """Return whether rates (K, n) are exact derivatives of values (K, n)."""
    step = np.diff(time)[:, None]
    missed = np.diff(value, axis=0) - 0.5 * step * (rate[1:] + rate[:-1])
    return bool(
        np.linalg.norm(missed) <= _MAX_RATE_ERROR * np.linalg.norm(step * np.diff(rate, axis=0))
    )


@dataclass(frozen=True, eq=False)
class MotionPiece:
    """Part of a motion between two rests."""

    path: JointPath
    # (K,) instants of the given motion [s], its path parameter and the rate of that [1/s].
    times: np.ndarray
    places: np.ndarray
    rates: np.ndarray
    dwell: float  # rest after it [s]

    def speed(self, s: np.ndarray) -> np.ndarray:
        """Rate of the path parameter [1/s] of the given motion at path parameters (K,)."""
        least = _LEAST_SPEED_SHARE / (self.times[-1] - self.times[0])
        return np.asarray(np.maximum(np.interp(s, self.places, self.rates), least))


def moving_pieces(given: GivenMotion) -> list[MotionPiece]:
    """Return the pieces of a motion between rests, with their paths by arc length."""
    edges = [0.0, *itertools.chain.from_iterable(given.rests), given.duration]
    moves = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a]
    # The halves of a window that the pieces have on either side of a rest pass in no time.
    dwells = [after - end + _MIN_DWELL for (_, end), (after, _) in itertools.pairwise(moves)]
    return [
        _piece(given.plan, begin, end, dwell)
        for (begin, end), dwell in zip(moves, [*dwells, 0.0], strict=True)
    ]


def _piece(motion: JointMotion, begin: float, end: float, dwell: float) -> MotionPiece:
    count = max(_MIN_ARC_SAMPLES, int(np.ceil((end - begin) / 5e-4)) + 1)
    time = np.linspace(begin, end, count)
    rate = np.linalg.norm(motion(time, 1), axis=1)
    middle = np.linalg.norm(motion(0.5 * (time[1:] + time[:-1]), 1), axis=1)
    steps = np.diff(time) * (rate[:-1] + 4.0 * middle + rate[1:]) / 6.0
    covered = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-15))])
    length = covered[-1]
    along = CubicHermiteSpline(time, covered, rate)

    def curve(s: np.ndarray) -> np.ndarray:
        """Joint positions at shares of the arc length."""
        asked = length * s
        t = np.interp(asked, covered, time)
        for _ in range(3):
            slope = np.maximum(along(t, 1), 1e-3 * rate.max())
            t = np.clip(t - (along(t) - asked) / slope, begin, end)
        return np.asarray(motion(t))

    def error(q: np.ndarray, s: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(q - curve(s)).max(axis=1))

    path, _ = fit_joint_path(curve, np.array([0.0, 1.0]), error, _PATH_TOLERANCE)
    return MotionPiece(path, time, covered / length, rate / length, dwell)
