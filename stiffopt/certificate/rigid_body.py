"""Torques, tool positions and Jacobians along a motion, from pinocchio and its model alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from stiffopt.certificate.moving_joints import (
    JointGeometry,
    MovingJoint,
    holding_torques,
    joint_geometries,
    moving_joints,
    point_jacobian,
)
from stiffopt.robot.bodies_in_motion import torques_along
from stiffopt.robot.rigid_body import without_rotors

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Instants at once: what they take stays in the processor's cache.
_BLOCK_INSTANTS = 2000


@dataclass(frozen=True)
class RigidBodyHistory:
    """Rigid-body quantities along a motion of K instants and n joints.

    Parameters
    ----------
    link_torque : array (K, n) [N m]
        Inverse dynamics of links and payload, without rotors and friction.
    gravity_torque : array (K, n) [N m]
        At rest in the same pose.
    tool : array (K, 3) [m]
    jacobian : array (K, 3, n) [m/rad]
        Position Jacobian of the tool, base axes.
    """

    link_torque: np.ndarray
    gravity_torque: np.ndarray
    tool: np.ndarray
    jacobian: np.ndarray


def rigid_body_history(
    robot: Robot, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> RigidBodyHistory:
    """Evaluate pinocchio's model at every instant; arrays (K, n)."""
    model, tool = without_rotors(robot.model), robot.tool
    places, weight = joint_geometries(model), np.asarray(model.gravity.linear)
    count, n = position.shape
    gravity_torque, along = np.empty((count, n)), np.empty((count, 3))
    jacobian = np.empty((count, 3, n))
    for block, joints in _in_blocks(places, position):
        point = joints[tool.joint - 1].point(np.asarray(tool.offset))
        along[block] = point.T
        gravity_torque[block] = holding_torques(joints, weight)
        jacobian[block] = point_jacobian(joints, tool.joint, point)
    link_torque = torques_along(model, position, velocity, acceleration)
    return RigidBodyHistory(link_torque, gravity_torque, along, jacobian)


def link_torques(
    robot: Robot, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    """`RigidBodyHistory.link_torque` alone; arrays (K, n)."""
    return torques_along(without_rotors(robot.model), position, velocity, acceleration)


def tool_positions(robot: Robot, position: np.ndarray) -> np.ndarray:
    """Tool positions (K, 3) [m] of joint positions (K, n)."""
    places, tool = joint_geometries(robot.model), robot.tool
    found = np.empty((len(position), 3))
    for block, joints in _in_blocks(places, position):
        found[block] = joints[tool.joint - 1].point(np.asarray(tool.offset)).T
    return found


def _in_blocks(
    places: list[JointGeometry], position: np.ndarray
) -> Iterator[tuple[slice, list[MovingJoint]]]:
    """Instants at once, and the joints at them, of positions (K, n)."""
    for first in range(0, len(position), _BLOCK_INSTANTS):
        block = slice(first, first + _BLOCK_INSTANTS)
        yield block, moving_joints(places, position[block])


def tool_angle(robot: Robot, position: np.ndarray, rpy: np.ndarray) -> np.ndarray:
    """Angle (K,) [rad] between the tool and an orientation given as roll, pitch, yaw [rad]."""
    wanted = pin.rpy.rpyToMatrix(np.asarray(rpy, dtype=float))
    own = np.asarray(robot.tool.rotation)
    data = robot.model.createData()
    angles = np.empty(len(position))
    for k, q in enumerate(position):
        pin.forwardKinematics(robot.model, data, q)
        rotation = data.oMi[robot.tool.joint].rotation @ own
        angles[k] = np.linalg.norm(pin.log3(wanted.T @ rotation))
    return angles
