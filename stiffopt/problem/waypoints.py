"""Tool poses as rows: positions that are met exactly at the ends, within a tolerance at vias."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.dynamics.kinematics import tool_pose
from stiffopt.problem.trajectory import Target, TrajectoryProblem
from stiffopt.robot.rotations import rotation_from_rpy
from stiffopt.transcription.ocp import Rows, Waypoint

if TYPE_CHECKING:
    from stiffopt.symbolic import Quantity


def boundary_waypoint(problem: TrajectoryProblem, target: Target, side: str) -> Waypoint:
    """The tool position at the start or end of a motion whose end pose is otherwise free."""
    x, position, _ = _tool(problem)
    rows = Rows.make(f"{side} position", ["x", "y", "z"], 0.0, 0.0, unit="m")
    return Waypoint(function=ca.Function(side, [x], [position - target.position]), rows=(rows,))


def via_waypoint(problem: TrajectoryProblem, target: Target, number: int) -> Waypoint:
    """A via point: joints, a tool position or a tool pose, each within its tolerance."""
    x, position, rotation = _tool(problem)
    name = f"via {number}"
    if target.joints is not None:
        labels = [f"joint {j + 1}" for j in range(problem.joints)]
        miss = (x[: problem.joints] - target.joints) / target.tolerance
        rows = Rows.make(name, labels, -1.0, 1.0)
        return Waypoint(function=ca.Function("via", [x], [miss]), rows=(rows,))
    offset = (position - target.position) / target.tolerance
    blocks = [Rows.make(name, ["tool position"], -np.inf, 1.0)]
    expressions = [ca.dot(offset, offset)]
    if target.rpy is not None:
        wanted = rotation_from_rpy(target.rpy)
        # sin(angle) times the axis: smooth at zero, where the trace alone has no slope.
        difference = ca.mtimes(ca.DM(wanted.T), rotation)
        sine = ca.vertcat(
            difference[2, 1] - difference[1, 2],
            difference[0, 2] - difference[2, 0],
            difference[1, 0] - difference[0, 1],
        ) / (2.0 * np.sin(target.angle_tolerance))
        blocks.append(Rows.make(name, ["tool orientation"], -np.inf, 1.0))
        expressions.append(ca.dot(sine, sine))
        # Excludes the half turn, whose sine is zero too.
        blocks.append(Rows.make(name, ["tool half turn"], 0.0, np.inf))
        expressions.append(ca.trace(difference) - 1.0)
    function = ca.Function("via", [x], [ca.vertcat(*expressions)])
    return Waypoint(function=function, rows=tuple(blocks))


def _tool(problem: TrajectoryProblem) -> tuple[ca.SX, Quantity, Quantity]:
    """Symbol of the state, and the tool's position and rotation there."""
    x = ca.SX.sym("x", 2 * problem.joints)
    tool = problem.robot.tool
    position, rotation = tool_pose(
        problem.robot.tree, tool.joint, tool.offset, tool.rotation, x[: problem.joints]
    )
    return x, position, rotation
