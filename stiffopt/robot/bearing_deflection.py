"""Displacement of the tool by elastic output bearings and bending links, quasi-static.

A bearing yields against the wrench [F, M] of its joint but about the axis, where the drivetrain
yields; a link against the mean of the wrenches of its own and the next joint. Displacements are
small: those of all add up.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.robot.joint_load import joint_frames, joint_wrenches, supports_tool

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Displacement that counts as much as a rotation of 1 rad, where joints cannot correct both [m].
_ROTATION_LENGTH = 1e-2
# Damping of the correction near singular poses: lever arm with which a joint hardly moves the tool
# [m/rad], a tenth of the rotation's length.
_MIN_LEVER_ARM = 1e-3


def bearing_deflections(
    robot: Robot,
    position: np.ndarray,
    velocity: np.ndarray | None = None,
    acceleration: np.ndarray | None = None,
    force: np.ndarray | None = None,
) -> np.ndarray:
    """Displacement [m] and rotation [rad] of the tool by each joint's bearing and link.

    (K, n, 6) in base axes, at positions (K, n) of the links; default at rest and without a force ON
    the tool [N].
    """
    found = np.zeros((*position.shape, 6))
    if not robot.tilts:
        return found
    still = np.zeros_like(position)
    velocity, acceleration = (still if x is None else x for x in (velocity, acceleration))
    force = np.zeros(3) if force is None else np.atleast_2d(force)[:, None]
    wrench = joint_wrenches(robot, position, velocity, acceleration, force)
    axes, arm = joint_frames(robot, position)
    carrying = supports_tool(robot)
    for j, mount in ((k, each) for k, mounts in enumerate(robot.mounts) for each in mounts):
        loads = mount.loads(j)
        if not carrying[loads[-1]]:
            continue
        lever, load = arm[:, j] - axes[:, j] @ mount.place, np.zeros((len(position), 2, 3))
        for source in loads:
            own = wrench[:, source].reshape(-1, 2, 3) @ axes[:, source].swapaxes(1, 2)
            own[:, 1] += np.cross(lever - arm[:, source], own[:, 0])
            load += own / len(loads)
        own = axes[:, j] @ mount.axes
        away = -(load @ own * mount.compliance.reshape(2, 3)) @ own.swapaxes(1, 2)
        moved, turned = away[:, 0], away[:, 1]
        found[:, j] += np.concatenate([moved + np.cross(turned, lever), turned], axis=1)
    return found


def dynamic_bearing_deflections(
    robot: Robot,
    position: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    force: np.ndarray | None = None,
    path_force: np.ndarray | None = None,
) -> np.ndarray:
    """Deflections (K, n, 6) of a motion less those at rest in the same poses under `force`."""
    pressed = force if path_force is None else path_force + (0.0 if force is None else force)
    moving = bearing_deflections(robot, position, velocity, acceleration, pressed)
    return np.asarray(moving - bearing_deflections(robot, position, force=force))


def correcting_joints(robot: Robot, position: np.ndarray, deflection: np.ndarray) -> np.ndarray:
    """Changes (K, n) of the joints that move the tool against deflections (K, 6).

    Displacements come before rotations where there are fewer than six joints.
    """
    weight = np.repeat([1.0, _ROTATION_LENGTH], 3)
    bodies = robot.rigid_bodies()
    jacobian = weight[:, None] * np.array([bodies.jacobian(robot.tool, q) for q in position])
    across = jacobian.swapaxes(1, 2)
    left = jacobian @ across + _MIN_LEVER_ARM**2 * np.eye(6)
    return np.asarray(-(across @ np.linalg.solve(left, (weight * deflection)[..., None]))[..., 0])
