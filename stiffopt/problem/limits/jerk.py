"""Largest jerk of every joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.declaration import JointJerk
from stiffopt.errors import ProblemError
from stiffopt.problem.limit import LIMITS, Limits
from stiffopt.problem.limits.joint_magnitude import JointMagnitude
from stiffopt.problem.stage_terms import PathRows
from stiffopt.result.assessment import DriveHistory, Violation

if TYPE_CHECKING:
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import TrajectoryProblem


class Jerk(JointMagnitude):
    """Jerk limit, a bound of the controls' rate; jumps of the acceleration exceed any limit."""

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """One row per joint with planned links; refused on a fixed path."""
        if problem.plans_links:
            return super().rows(problem, model, margin)
        raise ProblemError(
            "Jerk limits cannot be kept on a fixed path: the path coordinate has a limited "
            'acceleration only. Write limits.jerk = "none" (inf in Python), or give poses instead '
            "of motion.path."
        )

    def violations(self, limits: Limits, motion: DriveHistory) -> list[Violation]:
        """Violation of the worst joint; acceleration jumps count by their slope on the grid."""
        slope = np.abs(np.diff(motion.acceleration, axis=0)) / np.diff(motion.time)[:, None]
        jerk = np.abs(motion.jerk)
        jerk[:-1] = np.maximum(jerk[:-1], slope)
        return [self._worst_violation(limits, motion, jerk)]


LIMITS.add(
    Jerk(
        "jerk",
        JointJerk,
        "angular jerk",
        "Largest jerk of each joint [rad/s^3, m/s^3]; the robot's own if left out, "
        '"none" for none.',
        order=3,
    )
)
