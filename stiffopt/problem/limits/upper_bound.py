"""Limits that are one number at most, on which the others build."""

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
    """A number at most; absent where it is left out.

    Parameters
    ----------
    name : str
        Of the key and the attribute.
    form : type
        Of the key in a file.
    unit : str
        SI.
    description : str
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
        """Whether it is finite."""
        return bool(np.isfinite(getattr(limits, self.name)))

    def read(self, section: Section, joints: JointLists) -> dict[str, Any]:
        """Values of the keys, what they are without one where they are left out."""
        given = {key.name: getattr(section, key.key) for key in self.keys}
        without = {key.name: key.value(joints.robot) for key in self.keys}
        return {name: without[name] if value is None else value for name, value in given.items()}

    def statements(self, limits: Limits, robot: Robot) -> list[tuple[str, float, str]]:
        """One line."""
        phrase = f"{self.name.replace('_', ' ')} at most"
        return [(phrase, getattr(limits, self.name), self.unit)]


class ToolMagnitudeBound(UpperBound):
    """|vector| <= limit at every instant."""

    @abstractmethod
    def vector(self, model: StageModel) -> Quantity:
        """What is limited (3,), symbolic."""

    @abstractmethod
    def magnitude(self, motion: Assessment) -> np.ndarray:
        """Its length on the fine grid (K,)."""

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """Squared, so that it is smooth at zero."""
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
        """The largest length."""
        series = self.magnitude(motion)
        k = int(np.argmax(series))
        excess = float(series[k] / getattr(limits, self.name) - 1.0)
        return [Violation(excess, self.name, None, float(motion.time[k]))]


class ArrivalBound(UpperBound):
    """A number at most, of the simulated second after arrival."""

    of_arrival = True
    smoothing = WINDUP_SMOOTHING

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """None: it holds after the motion."""
        return []

    def rest_missing(self, swing: SimulatedMotion) -> Violation:
        """Of a motion that does not end at rest."""
        return Violation(1.0, self.name, None, swing.duration)
