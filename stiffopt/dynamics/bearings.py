"""Displacement of the tool by elastic output bearings, symbolic.

As `robot.bearing_deflection`, by the wrenches of the symbolic recursion.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.dynamics.joint_axes import axis_joints
from stiffopt.dynamics.kinematics import axis_frames, point_position
from stiffopt.dynamics.newton_euler import joint_wrenches

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot
    from stiffopt.symbolic import Quantity


def dynamic_bearing_displacements(
    robot: Robot, q: Quantity, v: Quantity, a: Quantity
) -> dict[int, Quantity]:
    """Return the displacement of the tool by each bearing, beyond that at rest in the same pose.

    Parameters
    ----------
    robot : Robot
    q, v, a : SX (n,)
        Position, velocity and acceleration of the links.

    Returns
    -------
    dict of SX (3,)
        By index of the joint, base axes [m]. A constant force cancels.
    """
    if not robot.tilts:
        return {}
    tree, tool, still = robot.tree, robot.tool, ca.SX(np.zeros(robot.n))
    wrenches = joint_wrenches(tree, q, v, a) - joint_wrenches(tree, q, still, still)
    place = point_position(tree, tool.joint, tool.offset, q)
    found: dict[int, Quantity] = {}
    for number, (origin, rotation) in axis_frames(axis_joints(tree), q, tool.joint).items():
        bearing = robot.bearings[number - 1] if number else None
        if bearing is None:
            continue
        force, moment = wrenches[:3, number - 1], wrenches[3:, number - 1]
        offset = ca.vertcat(0.0, 0.0, bearing.position)
        compliance = bearing.compliance
        moved = -ca.mtimes(rotation, compliance[:3] * force)
        turned = -ca.mtimes(rotation, compliance[3:] * (moment - ca.cross(offset, force)))
        lever = place - origin - ca.mtimes(rotation, offset)
        found[number - 1] = moved + ca.cross(turned, lever)
    return found
