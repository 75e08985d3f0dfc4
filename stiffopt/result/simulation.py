"""What an elastic arm does with a motion: deviation of the tool in flight and after arrival."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stiffopt.result.assessment import PeakRms

# Within which a tool counts as settled where nothing else is said [m].
SETTLING_BAND = 5e-5
# Share by which simulated and planned deflection may differ without a word.
MAX_UNREPORTED_DIFFERENCE = 0.1
# Time for which a settled tool has been seen to stay in the band [s]: half a swing of 10 Hz.
_MIN_SETTLED_TIME = 0.05


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
        return self._rms_over(flight)

    @property
    def peak_after(self) -> float | None:
        """Largest deviation after arrival [m]; None where the motion does not end at rest."""
        rest = self._after_arrival
        return float(self.distance[rest].max()) if rest.any() else None

    @property
    def rms_after(self) -> float | None:
        """Root mean square after arrival, of what is simulated [m]: the residual vibration."""
        return self._rms_over(self._after_arrival) if self._after_arrival.any() else None

    @property
    def settling_time(self) -> float | None:
        """Time from the arrival until the tool stays within the band [s].

        None where it does not within the simulated time, or does not come to rest at all.
        """
        rest = self._after_arrival
        if not rest.any():
            return None
        outside = np.flatnonzero(self.distance[rest] > self.band)
        if not outside.size:
            return 0.0
        after = self.time[rest] - self.duration
        last = int(outside[-1])
        # Nearer to the end it may only be passing through.
        return None if after[-1] - after[last] < _MIN_SETTLED_TIME else float(after[last + 1])

    @property
    def _after_arrival(self) -> np.ndarray:
        if self.time[-1] <= self.duration:
            return np.zeros(len(self.time), dtype=bool)
        return np.asarray(self.time >= self.duration)

    def _rms_over(self, chosen: np.ndarray) -> float:
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


@dataclass(frozen=True, kw_only=True)
class SimulatedPart:
    """A part of the tool's deflection in flight, as planned and simulated.

    Parameters
    ----------
    name : str
        "dynamic", "total" or "process".
    planned, simulated : PeakRms
        [m].
    """

    name: str
    planned: PeakRms
    simulated: PeakRms


@dataclass(frozen=True, kw_only=True)
class ElasticMotion:
    """A motion as it was planned and as the elastic arm does it.

    Parameters
    ----------
    name : str
        "optimised" or that of a baseline.
    planned : PeakRms
        Of the quasi-static dynamic deflection [m].
    simulated : SimulatedMotion
    counted : bool
        Whether it keeps all limits and the problem's duration.
    minimised : SimulatedPart or None
        The part of the deflection that is minimised, where it is not the dynamic one.
    """

    name: str
    planned: PeakRms
    simulated: SimulatedMotion
    counted: bool
    minimised: SimulatedPart | None = None

    @property
    def compared(self) -> SimulatedPart:
        """The part that is minimised, else the dynamic one."""
        if self.minimised is not None:
            return self.minimised
        found = PeakRms(self.simulated.peak, self.simulated.rms)
        return SimulatedPart(name="dynamic", planned=self.planned, simulated=found)

    @property
    def difference(self) -> float | None:
        """Simulated over planned peak in flight, less one; None where nothing was planned."""
        planned = self.compared.planned.peak
        if not 0.0 < planned < np.inf:
            return None
        return self.compared.simulated.peak / planned - 1.0


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """The optimised motion and the baselines on the elastic arm.

    Parameters
    ----------
    motions : tuple of ElasticMotion
        The optimised one first.
    measure : str
        "peak" or "rms", what is minimised of a deflection; "" where none is.
    assumed_damping : tuple of int
        Joints (from 1) whose damping is assumed.
    typical_hysteresis : float or None
        How far loops as measured on reducers may hold the tool from where it would hang at the end
        [m]; None where the arm's own are known and simulated.
    """

    motions: tuple[ElasticMotion, ...]
    measure: str
    assumed_damping: tuple[int, ...]
    typical_hysteresis: float | None = None

    @property
    def optimised(self) -> ElasticMotion:
        """The optimised motion."""
        return self.motions[0]

    def value(self, motion: ElasticMotion) -> float:
        """Simulated deflection in flight that is compared [m]."""
        found = motion.compared.simulated
        return found.rms if self.measure == "rms" else found.peak

    @property
    def better_baseline(self) -> ElasticMotion | None:
        """The counted baseline that deviates less in flight; None where none is counted."""
        counted = [motion for motion in self.motions[1:] if motion.counted]
        return min(counted, key=self.value, default=None)

    @property
    def ratio_to_better_baseline(self) -> float | None:
        """Simulated deflection over that of the better baseline, where it is what is minimised."""
        better = self.better_baseline
        if better is None or not self.measure or not self.optimised.counted:
            return None
        return self.value(self.optimised) / self.value(better) if self.value(better) > 0 else None

    @property
    def differs(self) -> bool:
        """Whether the optimised motion's deflection is not what was planned."""
        difference = self.optimised.difference
        return difference is not None and abs(difference) > MAX_UNREPORTED_DIFFERENCE


def simulation_document(simulation: Simulation | None) -> dict[str, Any] | None:
    """Content of `simulation` in result.json, and of simulation.json."""
    if simulation is None:
        return None
    return {
        "motions": {motion.name: _elastic_document(motion) for motion in simulation.motions},
        "ratio_to_better_baseline": simulation.ratio_to_better_baseline,
        "assumed_damping": simulation.assumed_damping,
        "typical_hysteresis": simulation.typical_hysteresis,
    }


def _part_document(part: SimulatedPart | None) -> dict[str, Any] | None:
    if part is None:
        return None
    planned, simulated = dict(vars(part.planned)), dict(vars(part.simulated))
    return {"part": part.name, "planned": planned, "in_flight": simulated}


def _elastic_document(motion: ElasticMotion) -> dict[str, Any]:
    simulated = motion.simulated
    return {
        "counted": motion.counted,
        "duration": simulated.duration,
        "planned": dict(vars(motion.planned)),
        "in_flight": {"peak": simulated.peak, "rms": simulated.rms},
        "minimised": _part_document(motion.minimised),
        "after_arrival": {"peak": simulated.peak_after, "rms": simulated.rms_after},
        "settling_time": simulated.settling_time,
        "settling_band": simulated.band,
        "notes": simulated.notes,
    }
