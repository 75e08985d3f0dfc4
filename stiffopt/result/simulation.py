"""Elastic simulations: deviation of the tool in flight and after arrival, and their documents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stiffopt.files import pick
from stiffopt.result.tool_error import ERROR_PARTS, ToolError

# Default band within which a tool counts as settled [m].
SETTLING_BAND = 5e-5
# Relative difference of simulated and planned deflection above which reports state it.
MAX_UNREPORTED_DIFFERENCE = 0.1


@dataclass(frozen=True)
class PeakRms:
    """Peak over time and root mean square over time of a deflection's magnitude [m]."""

    peak: float
    rms: float


@dataclass(frozen=True, kw_only=True)
class SimulatedMotion:
    """Elastic simulation of one motion."""

    error: ToolError  # against the planned path, from its start until the end of the simulation
    # (K, n) link position [rad] and velocity [rad/s].
    position: np.ndarray
    velocity: np.ndarray
    # (K, n) wind-up [rad] and spring torque [N m].
    windup: np.ndarray
    spring_torque: np.ndarray
    band: float  # band within which the tool counts as settled [m]
    notes: tuple[str, ...] = ()  # limitations of the result

    @property
    def time(self) -> np.ndarray:
        """Instants (K,) [s]."""
        return self.error.time

    @property
    def duration(self) -> float:
        """Arrival of the planned path [s]; it is at rest afterwards."""
        return self.error.duration

    @property
    def deviation(self) -> np.ndarray:
        """Position error of the tool (K, 3), base axes [m]."""
        return self.error.position

    @property
    def distance(self) -> np.ndarray:
        """Magnitude of the position error (K,) [m]."""
        return self.error.distance

    @property
    def peak(self) -> float:
        """Largest deviation in flight [m]."""
        return float(self.distance[self.error.flight].max())

    @property
    def rms(self) -> float:
        """Root mean square of the deviation in flight [m]."""
        return self._rms_over(self.error.flight)

    @property
    def peak_after(self) -> float | None:
        """Largest deviation after arrival [m]; None where the motion does not end at rest."""
        rest = self.error.after
        return float(self.distance[rest].max()) if rest.any() else None

    @property
    def rms_after(self) -> float | None:
        """Root mean square of the residual vibration over the simulated time [m]."""
        return self._rms_over(self.error.after) if self.error.after.any() else None

    @property
    def settling_time(self) -> float | None:
        """Time from the arrival until the tool stays within the band [s].

        None if it does not settle within the simulated time or does not end at rest.
        """
        rest = self.error.after
        if not rest.any():
            return None
        outside = np.flatnonzero(self.distance[rest] > self.band)
        if not outside.size:
            return 0.0
        after = self.time[rest] - self.duration
        last = int(outside[-1])
        # Shorter stays at the end may only be passing through the band.
        # Least time within the band for a tool to count as settled [s]: half a period of 10 Hz.
        return None if after[-1] - after[last] < 0.05 else float(after[last + 1])

    def _rms_over(self, chosen: np.ndarray) -> float:
        time, square = self.time[chosen], self.distance[chosen] ** 2
        return float(np.sqrt(np.trapezoid(square, time) / (time[-1] - time[0])))


@dataclass(frozen=True, kw_only=True)
class SimulatedPart:
    """Planned and simulated part of the tool deflection in flight."""

    name: str  # "dynamic", "total" or "process"
    # [m].
    planned: PeakRms
    simulated: PeakRms


@dataclass(frozen=True, kw_only=True)
class ElasticMotion:
    """Motion as planned and as simulated on the elastic arm."""

    name: str  # "optimised" or the name of a baseline
    planned: PeakRms  # quasi-static dynamic deflection [m]
    simulated: SimulatedMotion
    counted: bool  # True if the motion keeps all limits and the problem's duration
    # Minimised part of the deflection, if other than the dynamic one.
    minimised: SimulatedPart | None = None

    @property
    def compared(self) -> SimulatedPart:
        """Minimised part, else the dynamic one."""
        if self.minimised is not None:
            return self.minimised
        found = PeakRms(self.simulated.peak, self.simulated.rms)
        return SimulatedPart(name="dynamic", planned=self.planned, simulated=found)

    @property
    def difference(self) -> float | None:
        """Relative difference of simulated to planned peak in flight; None without a plan."""
        planned = self.compared.planned.peak
        if not 0.0 < planned < np.inf:
            return None
        return self.compared.simulated.peak / planned - 1.0


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """Elastic simulations of the optimised motion and the baselines."""

    motions: tuple[ElasticMotion, ...]  # the optimised motion first
    measure: str  # minimised measure, "peak" or "rms"; "" if no deflection is minimised
    assumed_damping: tuple[int, ...]  # joints (from 1) with assumed damping
    # Offset of the tool at the end by hysteresis loops typical of reducers [m]; None where the
    # arm's own are known and simulated.
    typical_hysteresis: float | None = None

    @property
    def optimised(self) -> ElasticMotion:
        """Optimised motion."""
        return self.motions[0]

    @property
    def differs(self) -> bool:
        """True if simulated and planned deflection, where minimised, differ notably."""
        difference = self.optimised.difference if self.measure else None
        return difference is not None and abs(difference) > MAX_UNREPORTED_DIFFERENCE


def simulation_document(simulation: Simulation | None) -> dict[str, Any] | None:
    """Content of `simulation` in result.json, and of simulation.json."""
    if simulation is None:
        return None
    return {
        "motions": {motion.name: _elastic_document(motion) for motion in simulation.motions},
        **pick(simulation, "assumed_damping", "typical_hysteresis"),
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
        **simulated_document(simulated),
        "minimised": _part_document(motion.minimised),
        "settling_time": simulated.settling_time,
        "settling_band": simulated.band,
    }


def simulated_document(simulated: SimulatedMotion) -> dict[str, Any]:
    """Return peak and rms of the tool error with its parts, and the notes of a simulation."""
    flight, after = (
        _phase_parts(simulated.error, phase)
        for phase in (simulated.error.flight, simulated.error.after)
    )
    return {
        "in_flight": {"peak": simulated.peak, "rms": simulated.rms, **flight},
        "after_arrival": {"peak": simulated.peak_after, "rms": simulated.rms_after, **after},
        "notes": simulated.notes,
    }


def _phase_parts(error: ToolError, phase: np.ndarray) -> dict[str, float | None]:
    """Return the peaks of the parts of the tool error; None where the phase was not simulated."""
    if not phase.any():
        return dict.fromkeys(ERROR_PARTS)
    peaks = error.peaks(phase)
    return {name: float(peaks[name]) for name in ERROR_PARTS}
