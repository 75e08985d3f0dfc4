"""A scene to stand in a page: the still above it, and the texts that make it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from stiffopt.report.scene.document import scene_document, scene_json
from stiffopt.report.scene.poses import Poses, tool_positions
from stiffopt.report.scene.still import still_caption, still_figure
from stiffopt.report.solve.space_figures import exaggeration

if TYPE_CHECKING:
    from stiffopt.robot.cell import Cell
    from stiffopt.robot.robot import Robot


@dataclass(frozen=True)
class ArmInSpace:
    """A figure with its caption, and the texts of the scene, which stand on a page unescaped."""

    still: Figure
    caption: str
    embedded: dict[str, Markup]


def embedded_scene(
    robot: Robot, motions: Mapping[str, Poses], part: str, cell: Cell | None = None
) -> ArmInSpace:
    """The first motion, bent by a part of its deflection, and the ghost of the second.

    Parameters
    ----------
    robot : Robot
    motions : mapping of name to Poses
    part : str
        Of the deflection; where that is zero, the first that is not.
    cell : Cell, optional
        What stands around the arm.
    """
    first = next(iter(motions.values()))
    shown = part if part in first.bend else next(iter(first.bend), "")
    tool = tool_positions(robot.tree, robot.tool, first.position)
    extent = max(float(np.ptp(tool, axis=0).max()), 1e-3)
    factor = exaggeration(extent, float(first.deflection[shown].max())) if shown else 1.0
    still = still_figure(robot.tree, robot.tool, list(motions.values()), shown, factor, cell)
    here = resources.files("stiffopt.report.scene")
    texts = {
        "document": scene_json(scene_document(robot, motions, shown, factor, cell)),
        "library": here.joinpath("three.min.js").read_text(encoding="utf-8"),
        "script": here.joinpath("scene.js").read_text(encoding="utf-8"),
    }
    # Scripts of this package, and data whose "<" is escaped.
    return ArmInSpace(
        still,
        still_caption(motions, shown, factor),
        {name: Markup(text) for name, text in texts.items()},
    )
