"""Torques, tool positions and Jacobians along a motion, from pinocchio and its model alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from stiffopt.robot.added_torque import MotionState, sum_added_torques
from stiffopt.robot.rigid_body import inverse_dynamics_along, without_rotors

if TYPE_CHECKING:
    from stiffopt.robot.frames import LinkFrame
    from stiffopt.robot.robot import Robot


@dataclass(frozen=True)
class JointGeometry:
    """Constants of one joint and its body, in the joint's own frame if not said otherwise."""

    parent: int  # number of the parent joint, from 1; 0 is the base
    prismatic: bool
    place: int  # index of its value among the positions
    within: np.ndarray  # (3, 3) a frame whose third column is the axis
    # (3, 3), (3,) [m] of that frame and of the origin, in such a frame of the parent.
    rotation: np.ndarray
    translation: np.ndarray
    mass: float  # [kg]
    centre: np.ndarray  # (3,) [m] of mass


@dataclass(frozen=True)
class MovingJoint:
    """One joint at K instants; base axes."""

    of: JointGeometry
    origin: np.ndarray  # (3, K) [m]
    frame: np.ndarray  # (3, 3, K) vectors of its frame, the axis last

    @property
    def axis(self) -> np.ndarray:
        """Unit vector (3, K)."""
        return np.asarray(self.frame[2])

    def point(self, place: np.ndarray) -> np.ndarray:
        """Return the positions (3, K) [m] of a point (3,) [m] given in the joint's own frame."""
        return np.asarray(self.origin + _rotate_vectors(self.frame, place @ self.of.within))


def joint_geometries(model: Any) -> list[JointGeometry]:
    """Joints of a pinocchio model, in its order."""
    made: list[JointGeometry] = []
    for number in range(1, model.njoints):
        parent, joint = int(model.parents[number]), model.joints[number]
        held, body = model.jointPlacements[number], model.inertias[number]
        data = joint.createData()
        joint.calc(data, np.zeros(model.nq))
        # Velocity and turning rate for a unit of the joint's own.
        slide, turn = np.split(np.asarray(data.S, dtype=float).ravel(), 2)
        prismatic = not np.any(turn)
        within = _frame_along(slide if prismatic else turn)
        before = made[parent - 1].within.T if parent else np.eye(3)
        rotation, translation = before @ held.rotation @ within, before @ held.translation
        made.append(
            JointGeometry(
                parent, prismatic, joint.idx_q, within, rotation, translation, body.mass, body.lever
            )
        )
    return made


def moving_joints(places: list[JointGeometry], position: np.ndarray) -> list[MovingJoint]:
    """Joints at the positions (K, n) [rad] or [m]."""
    count = len(position)
    base = np.repeat(np.eye(3)[:, :, None], count, axis=2)
    made: list[MovingJoint] = []
    for of in places:
        parent = made[of.parent - 1] if of.parent else None
        before = base if parent is None else parent.frame
        origin = _rotate_vectors(before, of.translation)
        if parent is not None:
            origin += parent.origin
        # Columns of the frame's matrix times a constant rotation.
        frame = (of.rotation.T @ before.reshape(3, 3 * count)).reshape(3, 3, count)
        value = position[:, of.place]
        if of.prismatic:
            origin += frame[2] * value
        else:
            c, s = np.cos(value), np.sin(value)
            x, y = frame[0] * c + frame[1] * s, frame[1] * c - frame[0] * s
            frame[0], frame[1] = x, y
        made.append(MovingJoint(of, origin, frame))
    return made


def point_jacobian(joints: list[MovingJoint], carrier: int, point: np.ndarray) -> np.ndarray:
    """Return the position Jacobian (K, 3, n) of a point (3, K) [m] on joint `carrier`."""
    columns = np.zeros((len(joints), *point.shape))
    while carrier:
        joint = joints[carrier - 1]
        lever = point - joint.origin
        columns[carrier - 1] = (
            joint.axis if joint.of.prismatic else _cross_vectors(joint.axis, lever)
        )
        carrier = joint.of.parent
    return columns.transpose(2, 1, 0)


def holding_torques(joints: list[MovingJoint], gravity: np.ndarray) -> np.ndarray:
    """Return the gravity torques (K, n) [N m], or forces [N] of prismatic joints."""
    masses = [joint.of.mass for joint in joints]
    moments = [joint.of.mass * joint.point(joint.of.centre) for joint in joints]
    torques = np.empty((len(joints), joints[0].origin.shape[1]))
    for k in reversed(range(len(joints))):
        joint, parent = joints[k], joints[k].of.parent
        if parent:
            masses[parent - 1] += masses[k]
            moments[parent - 1] += moments[k]
        if joint.of.prismatic:
            torques[k] = -masses[k] * (gravity @ joint.axis)
        else:
            # The scalar triple product of axis, lever and weight is invariant to cyclic shifts.
            lever = moments[k] - masses[k] * joint.origin
            torques[k] = _dot_vectors(lever, _cross_vectors(joint.axis, gravity[:, None]))
    return torques.T


def _frame_along(axis: np.ndarray) -> np.ndarray:
    """Return a rotation whose third column is `axis`."""
    least = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = _cross_vectors(least, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, _cross_vectors(axis, x), axis])


def _rotate_vectors(frame: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return np.asarray((vector @ frame.reshape(3, -1)).reshape(3, -1))


def _cross_vectors(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _dot_vectors(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


# Instants evaluated together: their arrays fit the processor's cache.
_BLOCK_INSTANTS = 2000


@dataclass(frozen=True)
class RigidBodyHistory:
    """Rigid-body quantities along a motion of K instants and n joints."""

    # (K, n) [N m] inverse dynamics of links and payload, without rotors and friction; with added
    # torques of the links.
    link_torque: np.ndarray
    gravity_torque: np.ndarray  # (K, n) [N m] at rest in the same pose
    tool: np.ndarray  # (K, 3) [m] in the base, or the frame that carries the work
    jacobian: np.ndarray  # (K, 3, n) [m/rad] position Jacobian of the tool there


def rigid_body_history(
    robot: Robot, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> RigidBodyHistory:
    """Return the rigid-body quantities of pinocchio's model at every instant; arrays (K, n)."""
    model, tool = without_rotors(robot.model), robot.tool
    places, weight = joint_geometries(model), np.asarray(model.gravity.linear)
    count, n = position.shape
    gravity_torque, along = np.empty((count, n)), np.empty((count, 3))
    jacobian = np.empty((count, 3, n))
    for block, joints in _in_blocks(places, position):
        point = joints[tool.joint - 1].point(np.asarray(tool.offset))
        along[block] = _in_work(joints, tool.seen_from, point)
        gravity_torque[block] = holding_torques(joints, weight)
        moved = point_jacobian(joints, tool.joint, point)
        if tool.seen_from is not None:
            moved = moved - point_jacobian(joints, tool.seen_from.joint, point)
            moved = np.einsum("jik,kin->kjn", _work_axes(joints, tool.seen_from), moved)
        jacobian[block] = moved
    link_torque = inverse_dynamics_along(model, position, velocity, acceleration)
    if robot.added_torques:
        still = np.zeros_like(position)
        gravity_torque += _link_torques_added(robot, position, still, still, gravity_torque)
        link_torque += _link_torques_added(robot, position, velocity, acceleration, link_torque)
    return RigidBodyHistory(link_torque, gravity_torque, along, jacobian)


def link_torques(
    robot: Robot, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    """Return `RigidBodyHistory.link_torque` alone; arrays (K, n)."""
    torque = inverse_dynamics_along(without_rotors(robot.model), position, velocity, acceleration)
    if robot.added_torques:
        torque += _link_torques_added(robot, position, velocity, acceleration, torque)
    return torque


def _link_torques_added(robot: Robot, *motion: np.ndarray) -> np.ndarray:
    return added_torques(robot, motion, np.sign(motion[1]), in_spring=True)


def added_torques(
    robot: Robot, motion: Sequence[np.ndarray], direction: np.ndarray, *, in_spring: bool
) -> np.ndarray:
    """Return the added torques in the springs, or of the drives alone (K, n) [N m].

    `motion` is position, velocity, acceleration and torque in the springs, each (K, n); `direction`
    the sign of the velocity.
    """
    position, velocity, acceleration, load = (list(each.T) for each in motion)
    state = MotionState(
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        direction=list(direction.T),
        load=load,
    )
    return np.stack(sum_added_torques(robot.added_torques, state, in_spring=in_spring), axis=1)


def tool_positions(robot: Robot, position: np.ndarray) -> np.ndarray:
    """Return the tool positions (K, 3) [m] at joint positions (K, n)."""
    places, tool = joint_geometries(robot.model), robot.tool
    found = np.empty((len(position), 3))
    for block, joints in _in_blocks(places, position):
        point = joints[tool.joint - 1].point(np.asarray(tool.offset))
        found[block] = _in_work(joints, tool.seen_from, point)
    return found


def _work_axes(joints: list[MovingJoint], work: LinkFrame) -> np.ndarray:
    """Axes of the frame that carries the work, as rows (3, 3, K) in the base."""
    carrier = joints[work.joint - 1]
    columns = np.asarray(work.rotation).T @ carrier.of.within
    return np.stack([_rotate_vectors(carrier.frame, column) for column in columns])


def _in_work(joints: list[MovingJoint], work: LinkFrame | None, point: np.ndarray) -> np.ndarray:
    """Places (K, 3) of a point (3, K), base axes, in the frame that carries the work."""
    if work is None:
        return np.asarray(point.T)
    away = point - joints[work.joint - 1].point(np.asarray(work.offset))
    return np.asarray(np.einsum("jik,ik->kj", _work_axes(joints, work), away))


def _in_blocks(
    places: list[JointGeometry], position: np.ndarray
) -> Iterator[tuple[slice, list[MovingJoint]]]:
    """Yield blocks of instants with their joint frames, for positions (K, n)."""
    for first in range(0, len(position), _BLOCK_INSTANTS):
        block = slice(first, first + _BLOCK_INSTANTS)
        yield block, moving_joints(places, position[block])


def tool_angle(robot: Robot, position: np.ndarray, rpy: np.ndarray) -> np.ndarray:
    """Return the angle (K,) [rad] between the tool and an orientation roll, pitch, yaw [rad]."""
    wanted = pin.rpy.rpyToMatrix(np.asarray(rpy, dtype=float))
    own = np.asarray(robot.tool.rotation)
    data = robot.model.createData()
    angles = np.empty(len(position))
    for k, q in enumerate(position):
        pin.forwardKinematics(robot.model, data, q)
        rotation = data.oMi[robot.tool.joint].rotation @ own
        angles[k] = np.linalg.norm(pin.log3(wanted.T @ rotation))
    return angles
