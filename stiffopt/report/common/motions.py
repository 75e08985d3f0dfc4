"""The motions that a report compares, and the units of each joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import Solution

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem

OPTIMISED = "optimised"
PARTS = ("dynamic", "static", "process", "total")


@dataclass(frozen=True)
class Motion:
    """A motion with the name it bears on the page."""

    name: str
    assessment: Assessment
    feasible: bool

    @property
    def label(self) -> str:
        """Name, marked where a limit is exceeded."""
        return self.name if self.feasible else f"{self.name} (exceeds limits)"

    def magnitude(self, part: str) -> np.ndarray:
        """Magnitude of a part of the deflection, (K,) [m]."""
        return np.asarray(np.linalg.norm(self.assessment.deflection[part], axis=1))


def compared_motions(solution: Solution) -> list[Motion]:
    """List the optimised motion first, then the baselines that exist."""
    motions = []
    if solution.assessment is not None:
        motions.append(Motion(OPTIMISED, solution.assessment, solution.status.usable))
    for name, baseline in solution.baselines.items():
        if baseline.assessment is not None:
            motions.append(Motion(name, baseline.assessment, baseline.feasible))
    return motions


def better_baseline(solution: Solution, maximised: bool) -> str | None:
    """Name of the feasible baseline with the better objective; None where none is feasible."""
    values = {
        name: baseline.objective
        for name, baseline in solution.baselines.items()
        if baseline.feasible and baseline.objective is not None
    }
    if not values:
        return None
    choose = max if maximised else min
    return choose(values, key=lambda name: values[name])


@dataclass(frozen=True)
class JointUnits:
    """Factors from SI and unit names for one joint."""

    label: str
    prismatic: bool

    @property
    def position(self) -> tuple[float, str]:
        """Degrees or millimetres."""
        return (1e3, "mm") if self.prismatic else (180.0 / np.pi, "deg")

    @property
    def rate(self) -> str:
        """Unit of acceleration and jerk without the seconds; shown in SI."""
        return "m" if self.prismatic else "rad"

    @property
    def torque(self) -> str:
        """Unit of torque or force."""
        return "N" if self.prismatic else "N m"

    @property
    def stiffness(self) -> str:
        """Unit of stiffness."""
        return "N/m" if self.prismatic else "N m/rad"


def joint_units(problem: TrajectoryProblem) -> list[JointUnits]:
    """Labels J1.. and units of the joints."""
    return robot_joint_units(problem.robot)


def robot_joint_units(robot: Any) -> list[JointUnits]:
    """Labels J1.. and units of a robot's joints."""
    return [
        JointUnits(f"J{number}", bool(prismatic))
        for number, prismatic in enumerate(robot.prismatic, start=1)
    ]


def common_unit(units: list[str]) -> str:
    """One unit for an axis; several where the joints differ."""
    return " or ".join(dict.fromkeys(units))


def focus_part(problem: TrajectoryProblem) -> str:
    """Part of the deflection that the problem is about; dynamic unless another is minimised."""
    for objective in problem.objectives:
        if objective.name.endswith("_deflection"):
            return objective.name.removesuffix("_deflection")
    return "dynamic"
