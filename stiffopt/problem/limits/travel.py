"""Travel of every axis over that of the spline through the given poses."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from stiffopt.declaration import Bounds, Ratio
from stiffopt.problem.limit import LIMITS, LimitKey, LimitKind, Limits
from stiffopt.result.joint_path import JointPath

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
    from stiffopt.result.assessment import Assessment, Violation


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
    if not (given and np.isfinite(ratio)):
        return problem
    path = JointPath.through(motion.points, "chord")(np.linspace(0.0, 1.0, 201))
    need, most = np.ptp(path, axis=0), np.zeros(problem.joints)
    for kind in (problem.robot.prismatic, ~problem.robot.prismatic):
        most[kind] = np.max(need[kind], initial=0.0)
    # Least need of an axis, as a share of the largest of its kind: the others pass by its detour.
    beside = 0.5 * (ratio * np.maximum(need, (1.0 / 3.0) * most) - need)
    lower = np.maximum(limits.position_lower, path.min(axis=0) - beside)
    upper = np.minimum(limits.position_upper, path.max(axis=0) + beside)
    narrower = Limits(limits.values, position_lower=lower, position_upper=upper)
    return replace(problem, limits=narrower)
