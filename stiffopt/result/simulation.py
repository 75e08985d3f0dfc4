"""What an elastic arm does with a motion: deviation of the tool in flight and after arrival."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Within which a tool counts as settled where nothing else is said [m].
SETTLING_BAND = 5e-5


@dataclass(frozen=True, kw_only=True)
class SimulatedMotion:
    """One simulated motion.

    Parameters
    ----------
    time : array (K,) [s]
    duration : float
        When the command arrives [s]; the times after it are at rest.
    deviation : array (K, 3)
        Of the tool from where it would hang at rest at the commanded position, base axes [m].
    position, velocity : array (K, n)
        Of the links [rad], [rad/s].
    windup, spring_torque : array (K, n)
        [rad], [N m].
    band : float
        Within which the tool counts as settled [m].
    notes : tuple of str
        What limits the result.
    """

    time: np.ndarray
    duration: float
    deviation: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    windup: np.ndarray
    spring_torque: np.ndarray
    band: float
    notes: tuple[str, ...] = ()

    @property
    def distance(self) -> np.ndarray:
        """Size of the deviation (K,) [m]."""
        return np.asarray(np.linalg.norm(self.deviation, axis=1))

    @property
    def peak(self) -> float:
        """Largest deviation in flight [m]."""
        return float(self.distance[self.time <= self.duration].max())

    @property
    def rms(self) -> float:
        """Root mean square of the deviation in flight [m]."""
        flight = self.time <= self.duration
        return self._rms(flight)

    @property
    def peak_after(self) -> float | None:
        """Largest deviation after arrival [m]; None where the motion does not end at rest."""
        rest = self._rest
        return float(self.distance[rest].max()) if rest.any() else None

    @property
    def rms_after(self) -> float | None:
        """Root mean square after arrival, of what is simulated [m]: the residual vibration."""
        return self._rms(self._rest) if self._rest.any() else None

    @property
    def settling_time(self) -> float | None:
        """Time from the arrival until the tool stays within the band [s].

        None where it does not within the simulated time, or does not come to rest at all.
        """
        rest = self._rest
        if not rest.any():
            return None
        outside = np.flatnonzero(self.distance[rest] > self.band)
        if not outside.size:
            return 0.0
        last = int(outside[-1])
        after = self.time[rest] - self.duration
        return None if last == len(after) - 1 else float(after[last + 1])

    @property
    def _rest(self) -> np.ndarray:
        if self.time[-1] <= self.duration:
            return np.zeros(len(self.time), dtype=bool)
        return np.asarray(self.time >= self.duration)

    def _rms(self, chosen: np.ndarray) -> float:
        time, square = self.time[chosen], self.distance[chosen] ** 2
        return float(np.sqrt(np.trapezoid(square, time) / (time[-1] - time[0])))

    def summary(self) -> dict[str, float | None]:
        """The numbers that are reported, SI."""
        return {
            "duration": self.duration,
            "peak": self.peak,
            "rms": self.rms,
            "peak_after": self.peak_after,
            "rms_after": self.rms_after,
            "settling_time": self.settling_time,
            "band": self.band,
        }
