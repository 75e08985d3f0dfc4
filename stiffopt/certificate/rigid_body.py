"""Torques, tool positions and Jacobians along a motion, by pinocchio alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from stiffopt.robot.bodies_in_motion import torques_along
from stiffopt.robot.rigid_body import without_rotors

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot


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
    """Evaluate pinocchio at every instant; arrays (K, n)."""
    model = without_rotors(robot.model)
    tool = pin.Frame(
        "stiffopt_tool",
        robot.tool.joint,
        0,
        pin.SE3(np.asarray(robot.tool.rotation), np.asarray(robot.tool.offset)),
        pin.FrameType.OP_FRAME,
    )
    frame = model.addFrame(tool, False)
    link_torque = torques_along(model, position, velocity, acceleration)
    still = np.zeros_like(position)
    gravity_torque = torques_along(model, position, still, still)
    data = model.createData()
    count, joints = position.shape
    tool_position = np.empty((count, 3))
    # pin drops the second axis for an arm of one joint.
    full = np.empty((count, 6, joints) if joints > 1 else (count, 6))
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    # Pinocchio's own number, which the Jacobian's computation renews.
    place = data.oMf[frame].translation
    for k in range(count):
        full[k] = pin.computeFrameJacobian(model, data, position[k], frame, axes)
        tool_position[k] = place
    jacobian = np.ascontiguousarray(full.reshape(count, 6, joints)[:, :3])
    return RigidBodyHistory(link_torque, gravity_torque, tool_position, jacobian)


def link_torques(
    robot: Robot, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    """`RigidBodyHistory.link_torque` alone; arrays (K, n)."""
    return torques_along(without_rotors(robot.model), position, velocity, acceleration)


def tool_positions(robot: Robot, position: np.ndarray) -> np.ndarray:
    """Tool positions (K, 3) [m] of joint positions (K, n)."""
    data = robot.model.createData()
    found, offset = np.empty((len(position), 3)), np.asarray(robot.tool.offset)
    for k, q in enumerate(position):
        pin.forwardKinematics(robot.model, data, q)
        found[k] = data.oMi[robot.tool.joint].act(offset)
    return found


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
