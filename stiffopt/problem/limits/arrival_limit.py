"""Limits on what the tool does after the motors have stopped, on which the others build."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from stiffopt.declaration import POSITIVE
from stiffopt.problem.limit import LimitKey, LimitKind, Limits
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING, PathRows
from stiffopt.result.assessment import Violation

if TYPE_CHECKING:
    from stiffopt.problem.files import JointLists
    from stiffopt.problem.schema import LimitsSection
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.simulation import SimulatedMotion
    from stiffopt.robot.robot import Robot


class ArrivalLimit(LimitKind):
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

    of_arrival = True
    smoothing = WINDUP_SMOOTHING

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

    def read(self, section: LimitsSection, joints: JointLists) -> dict[str, Any]:
        """Values of the keys, what they are without one where they are left out."""
        given = {key.name: getattr(section, key.key) for key in self.keys}
        without = {key.name: key.value(joints.robot) for key in self.keys}
        return {name: without[name] if value is None else value for name, value in given.items()}

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """None: it holds after the motion."""
        return []

    def never_at_rest(self, swing: SimulatedMotion) -> Violation:
        """Of a motion that does not end at rest."""
        return Violation(1.0, self.name, None, swing.duration)

    def statements(self, limits: Limits, robot: Robot) -> list[tuple[str, float, str]]:
        """One line."""
        return [(f"{self.name.replace('_', ' ')} at most", getattr(limits, self.name), self.unit)]
