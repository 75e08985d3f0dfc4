"""Wrench of each joint: force and moment that it transmits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from stiffopt.robot.rigid_body import without_rotors

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot


def joint_wrenches(
    robot: Robot,
    position: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    force: np.ndarray,
) -> np.ndarray:
    """Force and moment (K, n, 6) of each joint on the links that it carries [N], [N m].

    About the joint's origin; axes are fixed to the link, the third is the joint's. Component 6 (3
    for a prismatic joint) is the torque of the joint's spring. `force` acts ON the tool, base axes
    [N], and broadcasts to (K, n, 3).
    """
    model = without_rotors(robot.model)
    data = model.createData()
    in_link = np.empty((*position.shape, 6))
    for k in range(len(position)):
        pin.rnea(model, data, position[k], velocity[k], acceleration[k])
        for i in range(model.nv):
            in_link[k, i] = data.f[i + 1].vector
    own = np.array([complete_axes(body.axis) for body in robot.tree.bodies])
    found = np.einsum("nij,knsi->knsj", own, in_link.reshape(*position.shape, 2, 3))
    if np.any(force):
        axes, arm = joint_frames(robot, position)
        pushed = np.stack([np.broadcast_to(force, arm.shape), np.cross(arm, force)], axis=2)
        held = supports_tool(robot)
        found[:, held] -= np.einsum("knij,knsi->knsj", axes, pushed)[:, held]
    return np.asarray(found.reshape(in_link.shape))


def joint_frames(robot: Robot, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes of `joint_wrenches`, and vectors from the joints to the tool.

    Parameters
    ----------
    position : array (K, n)

    Returns
    -------
    (axes (K, n, 3, 3) as columns, arm (K, n, 3) [m])
        In base axes; the arm is 0 for joints that do not move the tool.
    """
    data = robot.model.createData()
    own = [complete_axes(body.axis) for body in robot.tree.bodies]
    loaded = supporting_joints(robot.model, robot.tool.joint)
    axes, arm = np.empty((*position.shape, 3, 3)), np.zeros((*position.shape, 3))
    for k, pose in enumerate(position):
        pin.forwardKinematics(robot.model, data, pose)
        place = data.oMi[robot.tool.joint]
        tool = place.translation + place.rotation @ robot.tool.offset
        for i in range(robot.model.nv):
            at = data.oMi[i + 1]
            axes[k, i] = at.rotation @ own[i]
            if i + 1 in loaded:
                arm[k, i] = tool - at.translation
    return axes, arm


def supports_tool(robot: Robot) -> np.ndarray:
    """Return which joints (n,) carry the tool."""
    joints = supporting_joints(robot.model, robot.tool.joint)
    return np.array([i + 1 in joints for i in range(robot.n)])


def shift_wrench(wrench: np.ndarray, position: float) -> np.ndarray:
    """Wrench (..., 6) about another point on the joint's axis, at `position` along it [m]."""
    moved = np.array(wrench, dtype=float)
    # M - h e_z x F
    moved[..., 3] += position * wrench[..., 1]
    moved[..., 4] -= position * wrench[..., 0]
    return moved


def complete_axes(axis: np.ndarray) -> np.ndarray:
    """Return right-handed axes as columns, the third along `axis`."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(other, axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def supporting_joints(model: pin.Model, joint: int) -> set[int]:
    """Return the joints (from 1) from the base to that of a link, inclusive."""
    found = set()
    while joint > 0:
        found.add(joint)
        joint = int(model.parents[joint])
    return found
