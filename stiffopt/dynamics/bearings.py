"""Displacement of the tool by elastic output bearings and bending links, symbolic.

As `robot.bearings`, by the wrenches of the symbolic recursion.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.dynamics.deflection import Deflection
from stiffopt.dynamics.joint_axes import axis_joints, clean
from stiffopt.dynamics.kinematics import axis_frames, point_position
from stiffopt.dynamics.newton_euler import joint_wrenches
from stiffopt.robot.joint_load import complete_axes

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot
    from stiffopt.symbolic import Quantity


def dynamic_bearing_displacements(
    robot: Robot, q: Quantity, v: Quantity, a: Quantity
) -> dict[int, Quantity]:
    """Return the displacement of the tool by bearing and link of each joint, less that at rest.

    `q`, `v` and `a` (n,): position, velocity and acceleration of the links. Returns dict of SX
    (3,): by index of the joint, base axes [m]. A constant force cancels.
    """
    if not robot.tilts:
        return {}
    still = ca.SX(np.zeros(robot.n))
    return _displacements(
        robot, q, joint_wrenches(robot.tree, q, v, a) - joint_wrenches(robot.tree, q, still, still)
    )


def bearing_deflection(
    robot: Robot, q: Quantity, v: Quantity, a: Quantity, force: np.ndarray
) -> Deflection:
    """Return the parts of the tool's deflection by bearings and links; `force` (3,) ON the tool."""
    still = ca.SX(np.zeros(robot.n))
    rest = joint_wrenches(robot.tree, q, still, still)
    moving = joint_wrenches(robot.tree, q, v, a) - rest

    def whole(wrenches: ca.SX) -> Quantity:
        return sum(_displacements(robot, q, wrenches).values(), ca.SX.zeros(3))

    return Deflection(
        static=whole(rest),
        dynamic=whole(moving),
        process=whole(_force_wrenches(robot, q, force)) if np.any(force) else ca.SX.zeros(3),
    )


def _force_wrenches(robot: Robot, q: Quantity, force: np.ndarray) -> ca.SX:
    """Return the wrenches (6, n) of the joints that hold a force (3,) ON the tool [N]."""
    tree, tool = robot.tree, robot.tool
    place = point_position(tree, tool.joint, tool.offset, q)
    found = ca.SX.zeros(6, robot.n)
    for number, (origin, rotation) in axis_frames(axis_joints(tree), q, tool.joint).items():
        if number:
            held = ca.vertcat(-force, ca.cross(place - origin, -force))
            for rows in (slice(0, 3), slice(3, 6)):
                found[rows, number - 1] = ca.mtimes(rotation.T, held[rows])
    return found


def _displacements(robot: Robot, q: Quantity, wrenches: ca.SX) -> dict[int, Quantity]:
    """Return the displacement of the tool (3,) [m] by joint index under wrenches (6, n)."""
    tree, tool = robot.tree, robot.tool
    place = point_position(tree, tool.joint, tool.offset, q)
    found: dict[int, Quantity] = {}
    joints = axis_joints(tree)
    frames, mounts = axis_frames(joints, q, tool.joint), robot.mounts
    for number, (origin, rotation) in frames.items():
        for mount in mounts[number - 1] if number else ():
            loads = mount.loads(number - 1)
            if loads[-1] + 1 not in frames:
                continue
            axis = tree.bodies[number - 1].axis
            turn = clean(joints[number - 1].from_joint_frame @ complete_axes(axis))
            point = origin + ca.mtimes(rotation, turn @ mount.place)
            axes = ca.mtimes(rotation, clean(turn @ mount.axes))
            force = about = ca.SX.zeros(3)
            for source in loads:
                at, held = frames[source + 1]
                pushed, moment = (
                    ca.mtimes(held, wrenches[rows, source]) / len(loads)
                    for rows in (slice(3), slice(3, 6))
                )
                force += pushed
                about += moment + ca.cross(at - point, pushed)
            moved = -ca.mtimes(axes, mount.compliance[:3] * ca.mtimes(axes.T, force))
            turned = -ca.mtimes(axes, mount.compliance[3:] * ca.mtimes(axes.T, about))
            away = moved + ca.cross(turned, place - point)
            found[number - 1] = found.get(number - 1, 0.0) + away
    return found
