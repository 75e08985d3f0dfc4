"""What a motion does to the robot on a fine grid: the quantities of certificate, report and files.

Pure data. `stiffopt.certificate.assess` fills it for the optimised motion and for the baselines
alike, so that the two are always compared with the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import relative

if TYPE_CHECKING:
    from stiffopt.result.simulation import SimulatedMotion


@dataclass(frozen=True)
class PeakRms:
    """Peak over time and root mean square over time of a deflection's magnitude [m]."""

    peak: float
    rms: float


@dataclass(frozen=True)
class Violation:
    """How far a limit is exceeded, relative to the limit; negative means margin left.

    `joint` is 1-based, None where the limit is not of one joint. Of a collision: the two things
    that come near, and the distance between them [m], negative where they overlap.
    """

    value: float
    limit: str
    joint: int | None
    time: float
    pair: tuple[str, str] | None = None
    distance: float | None = None

    def describe(self) -> str:
        """Text for messages: "torque of joint 2 at 0.210 s by 1.2 %"."""
        if self.pair is not None and self.distance is not None:
            names = " and ".join(self.pair)
            return f"the clearance of {names} at {self.time:.3f} s: {self.apart()}"
        owner = f" of joint {self.joint}" if self.joint else ""
        return (
            f"{self.limit.replace('_', ' ')}{owner} at {self.time:.3f} s by {relative(self.value)}"
        )

    def apart(self) -> str:
        """How far the two of a collision are apart: "12.3 mm deep", "35.0 mm apart"."""
        assert self.distance is not None
        return f"{1e3 * abs(self.distance):.1f} mm {'deep' if self.distance < 0 else 'apart'}"


@dataclass(frozen=True)
class LowestStiffness:
    """Lowest tangent stiffness of a joint along the motion."""

    value: float
    joint: int
    time: float


@dataclass(frozen=True)
class DriveHistory:
    """What the drives do along a motion.

    Parameters
    ----------
    time : array (K,) [s]
    position, velocity, acceleration, jerk : array (K, n) [rad, rad/s, rad/s^2, rad/s^3]
    torque : array (K, n)
        Drive torque [N m].
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    torque: np.ndarray

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.time[-1])


@dataclass(frozen=True)
class Assessment(DriveHistory):
    """Fine-grid evaluation of one motion with the unsmoothed model.

    Parameters
    ----------
    time, position, velocity, acceleration, jerk, torque : array
        As of `DriveHistory`.
    spring_torque : array (K, n)
        Torque in the joint's spring [N m].
    stiffness, windup : array (K, n)
        Tangent stiffness [N m/rad] and wind-up [rad] at the spring torque.
    tool : array (K, 3)
        Planned tool position, base frame [m].
    deflection : dict of array (K, 3)
        Keys dynamic, static, process, total; base frame [m]. They add up.
    violations : tuple of Violation
        The worst of every limit, worst first.
    lowest_stiffness : tuple of LowestStiffness
        One a joint.
    integrals : dict
        Time integrals and means, named by objective and joint: "torque_squared_2".
    link : array (K, n) or None
        Position [rad] of the links, sag calibrated away, where planned apart from the motors'.
    swing : SimulatedMotion or None
        The motion on the elastic arm, where a limit or an objective is about its arrival.
    """

    spring_torque: np.ndarray
    stiffness: np.ndarray
    windup: np.ndarray
    tool: np.ndarray
    tool_speed: np.ndarray
    deflection: dict[str, np.ndarray]
    violations: tuple[Violation, ...]
    lowest_stiffness: tuple[LowestStiffness, ...]
    integrals: dict[str, float] = field(default_factory=dict)
    link: np.ndarray | None = None
    swing: SimulatedMotion | None = None

    @property
    def worst_violation(self) -> Violation:
        """The limit that is exceeded most (or has the least margin)."""
        return self.violations[0]

    @property
    def min_stiffness(self) -> LowestStiffness:
        """The lowest stiffness of all joints."""
        return min(self.lowest_stiffness, key=lambda low: low.value)

    def feasible(self, tolerance: float) -> bool:
        """Whether no limit is exceeded by more than `tolerance` (relative)."""
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
    """Quantities of the optimiser's model along the motion it found.

    Parameters
    ----------
    time : array (K,)
        Nodes and midpoints [s].
    spring_torque : array (K, n)
        Of the springs [N m].
    torque : array (K, n) or None
        Of the drives [N m]; None where the optimiser knows it nearly only.
    friction_width : array (n,)
        Speed within which the dry friction in `torque` is smoothed: tanh(velocity/width) [rad/s].
    windup : array (K, n) or None
        [rad]; None where stiffness plays no part in the problem.
    deflection : dict of array (K, 3)
        Parts of the tool's deflection, base frame [m]; empty where none plays a part.
    """

    time: np.ndarray
    spring_torque: np.ndarray
    torque: np.ndarray | None
    friction_width: np.ndarray
    windup: np.ndarray | None = None
    deflection: dict[str, np.ndarray] = field(default_factory=dict)
