"""Motion averaged over a time window, of which input shaping makes a slow one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from stiffopt.result.trajectory import JointMotion

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
