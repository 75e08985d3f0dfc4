"""Range of every joint, as given or by the travel of the spline through the given poses."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from stiffopt.declaration import Bounds, JointPosition, Ratio
from stiffopt.errors import InputFileError
from stiffopt.problem.limit import LIMITS, DriveLimit, LimitKey, LimitKind, Limits
from stiffopt.problem.limits.joint_magnitude import worst_joint
from stiffopt.result.assessment import DriveHistory, Violation
from stiffopt.result.joint_path import JointPath

if TYPE_CHECKING:
    from stiffopt.problem.joint_lists import JointLists
    from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
    from stiffopt.result.assessment import Assessment
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
        """Range, narrowed by `margin` times its width at either end."""
        span = limits.position_upper - limits.position_lower
        inset = margin * np.where(np.isfinite(span), span, 0.0)
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


class Travel(LimitKind):
    """Limit on each axis's range, which becomes one of its position (`with_bounded_travel`)."""

    name = "travel"
    keys = (
        LimitKey(
            key="travel",
            form=Annotated[Ratio, Bounds(above=1.0)] | None,
            description="Largest range of each axis over that of a spline through the given poses, "
            "or over a third of the most that another axis needs; default 1.5 with tool_error, "
            "else none.",
            value=lambda robot: None,
        ),
    )

    def active(self, limits: Limits) -> bool:
        """Return False: limits of the position stand in its place."""
        return False

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """No violations."""
        return []


LIMITS.add(Travel())


def with_bounded_travel(problem: TrajectoryProblem, motion: ResolvedMotion) -> TrajectoryProblem:
    """Return the problem with the positions of its axes limited by their travel.

    Unchanged on a fixed path, where an end is given by the tool's position alone, and without need.
    """
    limits = problem.active_limits
    ratio = limits.travel
    if ratio is None:
        # Where the tool error is minimised.
        ratio = 1.5 if problem.judges_uncertain_arms else np.inf
    given = motion.start_fixed and motion.end_fixed and problem.path is None
    path = JointPath.through(motion.points, "chord")(np.linspace(0.0, 1.0, 201))
    need, most = np.ptp(path, axis=0), np.zeros(problem.joints)
    if not (given and np.isfinite(ratio) and need.any()):
        return problem
    for kind in (problem.robot.prismatic, ~problem.robot.prismatic):
        most[kind] = np.max(need[kind], initial=0.0)
    # Least need of an axis, as a share of the largest of its kind: the others pass by its detour.
    beside = 0.5 * (ratio * np.maximum(need, (1.0 / 3.0) * most) - need)
    lower = np.maximum(limits.position_lower, path.min(axis=0) - beside)
    upper = np.minimum(limits.position_upper, path.max(axis=0) + beside)
    narrower = Limits(limits.values, position_lower=lower, position_upper=upper)
    return replace(problem, limits=narrower)
