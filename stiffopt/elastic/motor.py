"""Motor motion: positions of the motors over time."""

from __future__ import annotations

from bisect import bisect_right
from functools import cached_property

import numpy as np
import scipy

from stiffopt.result.trajectory import JointMotion

# Between samples [s]; cubic interpolation is then exact to a nanoradian.
SAMPLE_INTERVAL = 5e-4
# Final speed of a motion that ends at rest [rad/s].
_MAX_REST_SPEED = 1e-6


class MotorMotion:
    """Motor positions over time, cubic between samples, at rest after the last one.

    `time` (K,): from 0, strictly increasing [s]. `position` and `velocity` (K, n) [rad], [rad/s].
    `duration`: when the command arrives [s]; default the last sample.
    """

    def __init__(
        self,
        time: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        duration: float | None = None,
    ) -> None:
        self.time = np.asarray(time, dtype=float)
        self.duration = float(self.time[-1]) if duration is None else duration
        self._end = float(self.time[-1])
        self._spline = scipy.interpolate.CubicHermiteSpline(self.time, position, velocity)
        self._last = np.array(position[-1], dtype=float)
        self._still = np.zeros_like(self._last)
        self.ends_at_rest = bool(np.max(np.abs(velocity[-1])) < _MAX_REST_SPEED)

    @classmethod
    def of(cls, motion: JointMotion) -> MotorMotion:
        """Sample a motion `motion(t, order)`, also at its break times (`motion.times`)."""
        count = max(2, int(np.ceil(motion.duration / SAMPLE_INTERVAL)) + 1)
        breaks = np.asarray(getattr(motion, "times", ()), dtype=float)
        time = np.union1d(np.linspace(0.0, motion.duration, count), breaks)
        time = time[np.concatenate([[True], np.diff(time) > 1e-9 * motion.duration])]
        return cls(time, motion(time, 0), motion(time, 1))

    def __call__(self, t: object, order: int = 0) -> np.ndarray:
        """Positions (order 0) or their derivatives (K, n) at the times (K,)."""
        times = np.asarray(t, dtype=float)
        value = self._spline(np.clip(times, 0.0, self._end), order)
        if order == 0:
            return np.asarray(value)
        return np.where((times > self._end)[..., None], 0.0, value)

    def part(self, begin: float, end: float) -> MotorMotion:
        """Return the motion from `begin` to `end` [s], at rest after its own end."""
        first, last = np.searchsorted(self.time, [begin, end], side="right")
        time = np.unique(np.concatenate([[begin], self.time[first:last], [end]]))
        return MotorMotion(time - begin, self(time), self(time, 1))

    @cached_property
    def _pieces(self) -> np.ndarray:
        """Positions, then velocities, highest power first (k, 4, 2 n)."""
        powers = self._spline.c.transpose(1, 0, 2)
        n = powers.shape[2]
        both = np.zeros((len(powers), 4, 2 * n))
        both[:, :, :n] = powers
        np.multiply(powers[:, :3], np.array([3.0, 2.0, 1.0])[:, None], out=both[:, 1:, n:])
        return both

    @cached_property
    def _times(self) -> list[float]:
        return list(self.time.tolist())

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity (n,) at one instant."""
        if t > self._end:
            return self._last, self._still
        k = min(max(bisect_right(self._times, t) - 1, 0), len(self._pieces) - 1)
        x = t - self._times[k]
        both = np.dot(np.array((x * x * x, x * x, x, 1.0)), self._pieces[k])
        return both[: len(self._last)], both[len(self._last) :]

    def table(self) -> dict[str, np.ndarray | int]:
        """Break times (k + 1,), pieces (k, 4, 2 n) as in `at`, and the last position (n,)."""
        return {
            "pieces": len(self._pieces),
            "times": self.time,
            "motion": self._pieces,
            "last": self._last,
        }

    def acceleration(self, t: float) -> np.ndarray:
        """Acceleration (n,) at one instant."""
        return self._still if t > self._end else np.asarray(self._spline(t, 2))

    def position(self, times: np.ndarray) -> np.ndarray:
        """Positions (K, n) at the times (K,)."""
        return np.asarray(self._spline(np.clip(times, 0.0, self._end)))
