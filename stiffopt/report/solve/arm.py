"""The arm of a solve in space: a still for the top of the page, and the scene to turn and play."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from stiffopt.report.scene.document import scene_document, scene_json
from stiffopt.report.scene.poses import poses_along, tool_positions
from stiffopt.report.scene.still import still_caption, still_figure
from stiffopt.report.solve.figures import ComparedMotion
from stiffopt.report.solve.space_figures import exaggeration

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem


@dataclass(frozen=True)
class ArmInSpace:
    """A figure with its caption, and the texts of the scene, which stand on a page unescaped."""

    still: Figure
    caption: str
    embedded: dict[str, Markup]


def arm_in_space(
    problem: TrajectoryProblem, motions: Sequence[ComparedMotion], part: str
) -> ArmInSpace:
    """The first motion, bent by a part of its deflection, and the ghost of the second.

    Parameters
    ----------
    problem : TrajectoryProblem
    motions : sequence of ComparedMotion
    part : str
        Of the deflection; where that is zero, the first that is not.
    """
    robot = problem.robot
    poses = {motion.label: poses_along(problem, motion.assessment) for motion in motions}
    first = next(iter(poses.values()))
    shown = part if part in first.bend else next(iter(first.bend), "")
    tool = tool_positions(robot.tree, robot.tool, first.position)
    extent = max(float(np.ptp(tool, axis=0).max()), 1e-3)
    factor = exaggeration(extent, float(first.deflection[shown].max())) if shown else 1.0
    still = still_figure(robot.tree, robot.tool, list(poses.values()), shown, factor)
    caption = still_caption(poses, shown, factor)
    here = resources.files("stiffopt.report.scene")
    texts = {
        "document": scene_json(scene_document(robot, poses, shown, factor)),
        "library": here.joinpath("three.min.js").read_text(encoding="utf-8"),
        "script": here.joinpath("scene.js").read_text(encoding="utf-8"),
    }
    # Scripts of this package, and data whose "<" is escaped.
    return ArmInSpace(still, caption, {name: Markup(text) for name, text in texts.items()})
