"""Assessment of a motion on a fine grid, for certificate, report and files.

Pure data. `stiffopt.certificate.assess` computes it for the optimised motion and the baselines
alike, so that both are compared by the same quantities.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stiffopt.errors import format_relative
from stiffopt.result.simulation import PeakRms, SimulatedMotion
from stiffopt.result.tool_error import LedError


@dataclass(frozen=True)
class Violation:
    """Excess over a limit, relative to it; negative values are margins.

    `joint` is 1-based, None for limits without a joint. `pair` and `distance` [m] belong to
    collisions: the two bodies and their distance, negative where they overlap.
    """

    value: float
    limit: str
    joint: int | None
    time: float
    pair: tuple[str, str] | None = None
    distance: float | None = None

    def describe(self) -> str:
        """Format for messages: "torque of joint 2 at 0.210 s by 1.2 %"."""
        if self.pair is not None and self.distance is not None:
            names = " and ".join(self.pair)
            return f"the clearance of {names} at {self.time:.3f} s: {self.describe_distance()}"
        owner = f" of joint {self.joint}" if self.joint else ""
        excess = format_relative(self.value)
        return f"{self.limit.replace('_', ' ')}{owner} at {self.time:.3f} s by {excess}"

    def describe_distance(self) -> str:
        """Format the distance of a collision pair: "12.3 mm deep", "35.0 mm apart"."""
        assert self.distance is not None
        return f"{1e3 * abs(self.distance):.1f} mm {'deep' if self.distance < 0 else 'apart'}"


@dataclass(frozen=True)
class LowestStiffness:
    """Lowest tangent stiffness of a joint along a motion."""

    value: float
    joint: int
    time: float


@dataclass(frozen=True)
class DriveHistory:
    """Motion and torque of the drives."""

    time: np.ndarray  # (K,) [s]
    # (K, n) [rad, rad/s, rad/s^2, rad/s^3].
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    torque: np.ndarray  # (K, n) drive torque [N m]

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.time[-1])


@dataclass(frozen=True)
class Assessment(DriveHistory):
    """Fine-grid evaluation of one motion with the unsmoothed model."""

    spring_torque: np.ndarray  # (K, n) spring torque [N m]
    # (K, n) tangent stiffness [N m/rad] and wind-up [rad] at the spring torque.
    stiffness: np.ndarray
    windup: np.ndarray
    tool: np.ndarray  # (K, 3) planned tool position, base frame [m]
    tool_speed: np.ndarray
    # (K, 3) keys dynamic, static, process and their sum total; base frame [m].
    deflection: dict[str, np.ndarray]
    violations: tuple[Violation, ...]  # largest violation of each limit, worst first
    lowest_stiffness: tuple[LowestStiffness, ...]  # one per joint
    # Time integrals and means by objective and joint: "torque_squared_2".
    integrals: dict[str, float] = field(default_factory=dict)
    # (K, n) link positions [rad] without the calibrated sag, where planned apart from the motors'.
    link: np.ndarray | None = None
    # Elastic simulation, where a limit or an objective refers to residual vibration.
    simulated: SimulatedMotion | None = None
    # Error of an exact lead on uncertain arms, where an objective refers to it.
    led: LedError | None = None
    force: np.ndarray | None = None  # (K, 3) process force along a path, base axes [N]

    @property
    def worst_violation(self) -> Violation:
        """Largest violation, or least margin."""
        return self.violations[0]

    @property
    def min_stiffness(self) -> LowestStiffness:
        """Lowest stiffness of all joints."""
        return min(self.lowest_stiffness, key=lambda low: low.value)

    def feasible(self, tolerance: float) -> bool:
        """Return True if no limit is exceeded by more than `tolerance` (relative)."""
        return self.worst_violation.value <= tolerance

    def deflection_summary(self) -> dict[str, PeakRms]:
        """Peak and rms of each part of the deflection; rms by the trapezoidal rule."""
        summary = {}
        for part, vectors in self.deflection.items():
            square = np.sum(vectors**2, axis=1)
            mean = np.trapezoid(square, self.time) / self.duration
            summary[part] = PeakRms(float(np.sqrt(square.max())), float(np.sqrt(mean)))
        return summary


@dataclass(frozen=True)
class PredictedMotion:
    """Quantities predicted by the optimiser's model along its solution."""

    time: np.ndarray  # (K,) nodes and midpoints [s]
    spring_torque: np.ndarray  # (K, n) spring torque [N m]
    # (K, n) drive torque [N m]; None where the optimiser's model approximates it.
    torque: np.ndarray | None
    # (n,) smoothing width of the dry friction in `torque`, tanh(velocity/width) [rad/s].
    friction_width: np.ndarray
    # (K, n) wind-up [rad]; None where stiffness does not enter the problem.
    windup: np.ndarray | None = None
    # (K, 3) parts of the tool deflection, base frame [m]; empty where stiffness does not enter.
    deflection: dict[str, np.ndarray] = field(default_factory=dict)
