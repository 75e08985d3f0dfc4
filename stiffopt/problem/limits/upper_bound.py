"""Limits that are one number at most, on which the others build."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from stiffopt.declaration import POSITIVE
from stiffopt.problem.limit import LimitKey, LimitKind, Limits

if TYPE_CHECKING:
    from stiffopt.problem.files import JointLists
    from stiffopt.problem.schema import LimitsSection
    from stiffopt.robot.robot import Robot


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

    def read(self, section: LimitsSection, joints: JointLists) -> dict[str, Any]:
        """Values of the keys, what they are without one where they are left out."""
        given = {key.name: getattr(section, key.key) for key in self.keys}
        without = {key.name: key.value(joints.robot) for key in self.keys}
        return {name: without[name] if value is None else value for name, value in given.items()}

    def statements(self, limits: Limits, robot: Robot) -> list[tuple[str, float, str]]:
        """One line."""
        phrase = f"{self.name.replace('_', ' ')} at most"
        return [(phrase, getattr(limits, self.name), self.unit)]
