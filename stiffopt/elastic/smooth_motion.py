"""Smoothing of a planned motion, for feedforward by the wind-up of an elastic arm or by averaging.

Motor accelerations that lead by the wind-up contain the fourth derivative of the link motion, which
a jerk-limited plan does not have. The nearest spline of degree 7 has six continuous derivatives;
where the plan's jerk jumps it is off by about a hundredth of the jump times the
cube of the spacing of its knots (3e-7 rad for 200 rad/s^3 and 5 ms). It starts and ends at rest up
to its fourth derivative.

Source: least-squares splines, de Boor (2001), "A practical guide to splines", chapter XIV.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
import scipy

from stiffopt.result.trajectory import JointMotion, Trajectory

_SPLINE_DEGREE = 7
# Coefficients at either end that fix position, and rest up to the fourth derivative.
_FIXED_COEFFICIENTS = 5
_SAMPLES_PER_INTERVAL = 8
_MIN_INTERVALS = 12


def smooth_motion(plan: JointMotion, spacing: float) -> Trajectory:
    """Fit the nearest smooth motion to a plan, with the same ends and duration.

    The plan is at rest at both ends; `spacing` is the distance of the spline's knots [s].
    """
    duration = plan.duration
    pieces = max(round(duration / spacing), _MIN_INTERVALS)
    breaks = np.linspace(0.0, duration, pieces + 1)
    knots = np.concatenate([np.zeros(_SPLINE_DEGREE), breaks, np.full(_SPLINE_DEGREE, duration)])
    times = np.linspace(0.0, duration, _SAMPLES_PER_INTERVAL * pieces + 1)
    wanted = np.asarray(plan(times))
    basis = scipy.interpolate.BSpline.design_matrix(times, knots, _SPLINE_DEGREE).tocsc()
    coefficients = np.zeros((pieces + _SPLINE_DEGREE, wanted.shape[1]))
    coefficients[:_FIXED_COEFFICIENTS], coefficients[-_FIXED_COEFFICIENTS:] = wanted[0], wanted[-1]
    free = basis[:, _FIXED_COEFFICIENTS:-_FIXED_COEFFICIENTS]
    left = (free.T @ free).tocsc()
    right = free.T @ (wanted - basis @ coefficients)
    coefficients[_FIXED_COEFFICIENTS:-_FIXED_COEFFICIENTS] = np.asarray(
        scipy.sparse.linalg.spsolve(left, right)
    ).reshape(-1, wanted.shape[1])
    spline = scipy.interpolate.BSpline(knots, coefficients, _SPLINE_DEGREE)
    acceleration = [spline(breaks[:-1], nu=2 + j) / factorial(j) for j in range(_SPLINE_DEGREE - 1)]
    return Trajectory.from_acceleration(
        breaks, np.stack(acceleration, axis=1), wanted[0], np.zeros(wanted.shape[1])
    )


# Samples of the motion that is averaged.
_AVERAGING_SAMPLES = 8001


@dataclass(frozen=True, eq=False)
class AveragedMotion:
    """Motion averaged over a window before each instant, longer by that window."""

    motion: JointMotion
    window: float  # averaging window [s]

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.motion.duration + self.window

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Return positions (K, n) at times (K,); derivatives are not available."""
        if order:
            raise ValueError("only the position of an averaged motion is known")
        travelled = self._position_integral(t) - self._position_integral(
            np.asarray(t) - self.window
        )
        return np.asarray(travelled / self.window)

    def _position_integral(self, t: np.ndarray) -> np.ndarray:
        """Return the integral of the position from the start (K, n), at rest outside the motion."""
        end = self.motion.duration
        times = np.linspace(0.0, end, _AVERAGING_SAMPLES)
        position = self.motion(times)
        whole = scipy.interpolate.CubicHermiteSpline(
            times, position, self.motion(times, 1)
        ).antiderivative()
        outside = np.minimum(t, 0.0)[:, None] * position[0]
        outside += np.maximum(np.asarray(t) - end, 0.0)[:, None] * position[-1]
        return np.asarray(whole(np.clip(t, 0.0, end)) + outside)
