"""Torque regressors of single bodies and poses of frames along a whole motion.

Recursion from the base to a body (Featherstone 2008, chapter 5) in body frames, vectorised over
instants; torques are linear in the inertial parameters (Atkeson, An, Hollerbach 1986).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.robot.body_tree import Body, BodyTree
from stiffopt.robot.frames import LinkFrame

# Instants of one block, so that intermediate arrays fit into the processor's cache.
_BLOCK_INSTANTS = 2048
# Row and column of each element of the inertia among the parameters, behind mass and first moments.
_INERTIA_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def body_torque_regressor(
    tree: BodyTree, body: int, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> np.ndarray:
    """Joint torques (K, n, 10) per unit of every inertial parameter of one body (index from 0).

    In the order of `Body.inertial_parameters`; instants are contiguous in memory.
    """
    out = np.zeros((4 + len(_INERTIA_ENTRIES), tree.n, len(q)))
    for part in _split_blocks(len(q)):
        motion = [np.ascontiguousarray(x[part].T) for x in (q, v, a)]
        _add_torques(out[:, :, part], tree, body, *motion)
    return out.T


def tool_jacobians(
    tree: BodyTree, frame: LinkFrame, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Position (K, 3) [m] of a frame in the base or `seen_from`, and its Jacobian (K, 3, n) there.

    Parameters
    ----------
    q : array (K, n)
    """
    if frame.seen_from is not None:
        return _relative_jacobians(tree, frame, frame.seen_from, q)
    position, jacobian = np.zeros((3, len(q))), np.zeros((3, tree.n, len(q)))
    for part in _split_blocks(len(q)):
        own = np.ascontiguousarray(q[part].T)
        carried, turned = None, np.eye(3)[..., None]
        for joint in _supporting_joints(tree, frame.joint - 1):
            body = tree.bodies[joint]
            rotation, origin = _frame_in_parent(body, own[joint])
            position[:, part] += np.sum(turned * origin, axis=1)
            turned = np.sum(turned[:, :, None] * rotation, axis=1)
            carried = _BodyJacobian.on(carried, body, joint, rotation, origin)
        assert carried is not None
        position[:, part] += np.sum(turned * frame.offset[:, None], axis=1)
        moved = carried.shifted(frame.offset[:, None])
        jacobian[:, carried.joints, part] = np.sum(turned[:, None] * moved, axis=2)
    return position.T, np.moveaxis(jacobian, 2, 0)


def _relative_jacobians(
    tree: BodyTree, frame: LinkFrame, work: LinkFrame, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Position and Jacobian of a frame relative to that of the work, as of `tool_jacobians`."""
    position, jacobian = tool_jacobians(tree, frame.in_base, q)
    origin, carried = tool_jacobians(tree, work, q)
    axes = frame_rotations(tree, work, q)
    away = position - origin
    # The work's point at the frame: its origin's motion, and its rotation times the distance.
    for joint in _supporting_joints(tree, work.joint - 1):
        body = tree.bodies[joint]
        if not body.prismatic:
            own = LinkFrame(joint + 1, np.zeros(3), np.eye(3))
            axis = frame_rotations(tree, own, q) @ body.axis
            carried[:, :, joint] += np.cross(axis, away)
    place = np.einsum("kij,ki->kj", axes, away)
    return place, np.einsum("kij,kin->kjn", axes, jacobian - carried)


def frame_positions(tree: BodyTree, frame: LinkFrame, q: np.ndarray) -> np.ndarray:
    """Positions (K, 3) [m] of a frame in the base or `seen_from` at joint positions (K, n)."""
    if frame.seen_from is not None:
        away = frame_positions(tree, frame.in_base, q)
        away -= frame_positions(tree, frame.seen_from, q)
        return np.asarray(np.einsum("kij,ki->kj", frame_rotations(tree, frame.seen_from, q), away))
    position = np.zeros((3, len(q)))
    for part in _split_blocks(len(q)):
        place, own = frame.offset[:, None], np.ascontiguousarray(q[part].T)
        # From the frame to the base, so that one vector is rotated instead of a matrix.
        for joint in reversed(_supporting_joints(tree, frame.joint - 1)):
            rotation, origin = _frame_in_parent(tree.bodies[joint], own[joint])
            place = np.sum(rotation * place, axis=1) + origin
        position[:, part] = place
    return position.T


def frame_rotations(tree: BodyTree, frame: LinkFrame, q: np.ndarray) -> np.ndarray:
    """Axes (K, 3, 3) of a frame, as columns in the base or `seen_from`, at positions (K, n)."""
    if frame.seen_from is not None:
        own = frame_rotations(tree, frame.in_base, q)
        return np.asarray(frame_rotations(tree, frame.seen_from, q).swapaxes(1, 2) @ own)
    found = np.empty((len(q), 3, 3))
    for part in _split_blocks(len(q)):
        own, turned = np.ascontiguousarray(q[part].T), frame.rotation[..., None]
        for joint in reversed(_supporting_joints(tree, frame.joint - 1)):
            rotation, _ = _frame_in_parent(tree.bodies[joint], own[joint])
            turned = np.einsum("ijk,jlk->ilk", rotation, turned * np.ones(own.shape[1]))
        found[part] = np.moveaxis(turned, 2, 0)
    return found


@dataclass(frozen=True, eq=False)
class _BodyJacobian:
    """Jacobian of a body's frame by the joints that support it, in its own axes."""

    joints: list[int]
    # (j, 3, K) angular velocity, and velocity of the frame's origin, per unit speed of each joint.
    turning: np.ndarray
    moving: np.ndarray

    @staticmethod
    def on(
        before: _BodyJacobian | None,
        body: Body,
        joint: int,
        rotation: np.ndarray,
        origin: np.ndarray,
    ) -> _BodyJacobian:
        """Jacobian of the next body from that of its parent."""
        own = np.broadcast_to(body.axis[None, :, None], (1, 3, rotation.shape[2]))
        still = np.zeros_like(own)
        turning, moving = (still, own) if body.prismatic else (own, still)
        if before is None:
            return _BodyJacobian([joint], turning, moving)
        return _BodyJacobian(
            [*before.joints, joint],
            np.concatenate([_rotate_vectors(rotation, before.turning), turning]),
            np.concatenate([_rotate_vectors(rotation, before.shifted(origin)), moving]),
        )

    def shifted(self, place: np.ndarray) -> np.ndarray:
        """Velocity (j, 3, K) of a point (3, K) of the body per unit speed of each joint."""
        return np.asarray(self.moving + _cross_product(self.turning, place[None]))


def _add_torques(
    out: np.ndarray, tree: BodyTree, number: int, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> None:
    """Add the torque regressor (10, n, K) of one body; motion by joint (n, K)."""
    turning = turning_rate = np.zeros((3, q.shape[1]))
    # Gravity acts like an upward acceleration of the base.
    rising = np.broadcast_to(-tree.gravity[:, None], turning.shape)
    carried = None
    for joint in _supporting_joints(tree, number):
        body = tree.bodies[joint]
        rotation, origin = _frame_in_parent(body, q[joint])
        rising = rising + _cross_product(turning_rate, origin)
        rising = rising + _cross_product(turning, _cross_product(turning, origin))
        turning, turning_rate, rising = _rotate_vectors(
            rotation, np.stack([turning, turning_rate, rising])
        )
        speed, rate = (body.axis[:, None] * x[joint] for x in (v, a))
        if body.prismatic:
            rising = rising + rate + 2.0 * _cross_product(turning, speed)
        else:
            turning_rate = turning_rate + rate + _cross_product(turning, speed)
            turning = turning + speed
        carried = _BodyJacobian.on(carried, body, joint, rotation, origin)
    assert carried is not None
    for j, turned, moved in zip(carried.joints, carried.turning, carried.moving, strict=True):
        # Mass; then first moments m c: force A c, torque c x rising, where A c is the acceleration
        # of a point c relative to the origin.
        out[0, j] = _dot_product(moved, rising)
        first = _cross_product(moved, turning_rate) + _cross_product(
            _cross_product(moved, turning), turning
        )
        out[1:4, j] = first + _cross_product(rising, turned)
        # Inertia I: torque I turning_rate + turning x I turning.
        other = _cross_product(turned, turning)
        for k, (row, column) in enumerate(_INERTIA_ENTRIES, start=4):
            out[k, j] = turned[row] * turning_rate[column] + other[row] * turning[column]
            if row != column:
                out[k, j] += turned[column] * turning_rate[row] + other[column] * turning[row]


def _supporting_joints(tree: BodyTree, body: int) -> list[int]:
    """Joints (from 0) that support a body, from the base."""
    found = [body]
    while tree.bodies[found[0]].parent:
        found.insert(0, tree.bodies[found[0]].parent - 1)
    return found


def _frame_in_parent(body: Body, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3, K) and origin (3, K) of a body's frame in its parent's frame."""
    if body.prismatic:
        along = (body.rotation @ body.axis)[:, None] * position
        rotation = np.broadcast_to(body.rotation[..., None], (3, 3, len(position)))
        return rotation, body.translation[:, None] + along
    straight = np.outer(body.axis, body.axis)
    across = np.cross(np.eye(3), body.axis)
    still, sine, cosine = (
        (body.rotation @ x)[..., None] for x in (straight, across, np.eye(3) - straight)
    )
    rotation = still + sine * np.sin(position) + cosine * np.cos(position)
    return rotation, np.broadcast_to(body.translation[:, None], (3, len(position)))


def _rotate_vectors(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Rotate vectors (m, 3, K) from the parent's frame to the child's."""
    return np.asarray(sum(rotation[i] * vectors[:, i, None] for i in range(3)))


def _cross_product(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Vector product along the axis before the last."""
    (x0, x1, x2), (y0, y1, y2) = ([z[..., i, :] for i in range(3)] for z in (x, y))
    return np.stack([x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0], axis=-2)


def _dot_product(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(x[0] * y[0] + x[1] * y[1] + x[2] * y[2])


def _split_blocks(count: int) -> list[slice]:
    return [slice(first, first + _BLOCK_INSTANTS) for first in range(0, count, _BLOCK_INSTANTS)]
