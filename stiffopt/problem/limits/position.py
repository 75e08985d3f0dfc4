"""Range of every joint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.declaration import JointPosition
from stiffopt.errors import InputFileError
from stiffopt.problem.limit import LIMITS, DriveLimit, LimitKey, Limits
from stiffopt.problem.limits.joint_magnitude import worst_joint
from stiffopt.result.assessment import DriveHistory, Violation

if TYPE_CHECKING:
    from stiffopt.problem.joint_lists import JointLists
    from stiffopt.validation import Section


class Position(DriveLimit):
    """Lower and upper position limits; excess and back-off are relative to the whole range."""

    name = "position"
    order = 0
    keys = (
        LimitKey(
            key="position_lower",
            form=list[JointPosition] | None,
            description="Lowest position of each joint [rad, m]; the robot's own if left out.",
            value=lambda robot: robot.position_lower,
            of_robot=True,
        ),
        LimitKey(
            key="position_upper",
            form=list[JointPosition] | None,
            description="Highest position of each joint [rad, m]; the robot's own if left out.",
            value=lambda robot: robot.position_upper,
            of_robot=True,
        ),
    )

    def active(self, limits: Limits) -> bool:
        """Return True if any joint has a finite range."""
        return bool(np.any(np.isfinite(limits.position_upper - limits.position_lower)))

    def read(self, section: Section, joints: JointLists) -> dict[str, Any]:
        """Read lists or the robot's own limits."""
        values = {}
        for key in self.keys:
            given = getattr(section, key.name)
            values[key.name] = (
                key.value(joints.robot)
                if given is None
                else joints(given, "angle", f"limits.{key.name}")
            )
        lower, upper = values["position_lower"], values["position_upper"]
        for j in np.flatnonzero(lower >= upper):
            raise InputFileError(
                joints.path,
                "limits",
                f"joint {j + 1} has position_lower = {lower[j]:g} and position_upper = "
                f"{upper[j]:g}; lower must be below upper.",
            )
        return values

    def bounds(self, limits: Limits, margin: float) -> tuple[np.ndarray, np.ndarray]:
        """Range, narrowed at either end by the share margin / (1 + margin) of its width.

        So it keeps a width for every margin below 1.
        """
        span = limits.position_upper - limits.position_lower
        inset = margin / (1.0 + margin) * np.where(np.isfinite(span), span, 0.0)
        return limits.position_lower + inset, limits.position_upper - inset

    def violations(self, limits: Limits, motion: DriveHistory) -> list[Violation]:
        """Violation of the worst joint, relative to its range."""
        span = limits.position_upper - limits.position_lower
        beyond = np.maximum(
            motion.position - limits.position_upper, limits.position_lower - motion.position
        )
        with np.errstate(invalid="ignore"):
            excess = np.where(np.isfinite(span), beyond / span, -np.inf)
        return [worst_joint(self.name, excess, motion)]


LIMITS.add(Position())
