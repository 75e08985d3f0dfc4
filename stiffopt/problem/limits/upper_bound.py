"""Base classes of limits with one upper bound, on the tool and on residual vibration."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from stiffopt.declaration import POSITIVE
from stiffopt.problem.limit import LimitKey, LimitKind, Limits
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING, PathRows, squared_length
from stiffopt.result.assessment import Assessment, Violation

if TYPE_CHECKING:
    from stiffopt.problem.joint_lists import JointLists
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.simulation import SimulatedMotion
    from stiffopt.robot.robot import Robot
    from stiffopt.symbolic import Quantity
    from stiffopt.validation import Section


class UpperBound(LimitKind):
    """Upper bound of one number; infinite by default.

    Parameters
    ----------
    name : str
        Name of key and attribute.
    form : type
        Type of the key in a file.
    unit : str
        SI unit.
    """

    def __init__(self, name: str, form: Any, unit: str, description: str) -> None:
        self.name, self.unit = name, unit
        self.keys = (
            LimitKey(
                key=name,
                form=Annotated[form, POSITIVE] | None,
                description=description,
                value=lambda robot: np.inf,
            ),
        )

    def active(self, limits: Limits) -> bool:
        """Return True if the bound is finite."""
        return bool(np.isfinite(getattr(limits, self.name)))

    def read(self, section: Section, joints: JointLists) -> dict[str, Any]:
        """Values of the keys, with their defaults."""
        given = {key.name: getattr(section, key.key) for key in self.keys}
        without = {key.name: key.value(joints.robot) for key in self.keys}
        return {name: without[name] if value is None else value for name, value in given.items()}

    def statements(self, limits: Limits, robot: Robot) -> list[tuple[str, float, str]]:
        """Statement of the bound."""
        phrase = f"{self.name.replace('_', ' ')} at most"
        return [(phrase, getattr(limits, self.name), self.unit)]


class ToolMagnitudeBound(UpperBound):
    """Bound of a vector's length at the tool, at every instant."""

    @abstractmethod
    def vector(self, model: StageModel) -> Quantity:
        """Limited vector (3,), symbolic."""

    @abstractmethod
    def magnitude(self, motion: Assessment) -> np.ndarray:
        """Length of the vector on the fine grid (K,)."""

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """Row on the squared length, which is smooth at zero."""
        relative = self.vector(model) / getattr(problem.active_limits, self.name)
        return [
            PathRows(
                name=self.name,
                labels=("tool",),
                expressions=(squared_length(relative),),
                upper=(1.0 - margin) ** 2,
            )
        ]

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """Violation at the largest length."""
        series = self.magnitude(motion)
        k = int(np.argmax(series))
        excess = float(series[k] / getattr(limits, self.name) - 1.0)
        return [Violation(excess, self.name, None, float(motion.time[k]))]


class ArrivalBound(UpperBound):
    """Bound of a quantity of the simulated second after arrival."""

    of_arrival = True
    smoothing = WINDUP_SMOOTHING

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """No rows: the limit applies after the motion."""
        return []

    def rest_missing(self, simulated: SimulatedMotion) -> Violation:
        """Violation of a motion that does not end at rest."""
        return Violation(1.0, self.name, None, simulated.duration)
