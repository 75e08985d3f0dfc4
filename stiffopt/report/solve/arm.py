"""The arm of a solve in space: a still for the top of the page, and the scene to turn and play."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from stiffopt.report.scene.embedded import ArmInSpace, embedded_scene
from stiffopt.report.scene.poses import poses_along
from stiffopt.report.solve.figures import ComparedMotion

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem


def arm_in_space(
    problem: TrajectoryProblem, motions: Sequence[ComparedMotion], part: str
) -> ArmInSpace:
    """The first motion, bent by a part of its deflection, and the ghost of the second."""
    poses = {motion.label: poses_along(problem, motion.assessment) for motion in motions}
    return embedded_scene(problem.robot, poses, part, problem.cell)
