"""Symbolic inverse dynamics of an arm: recursive Newton-Euler over its bodies.

Source: Luh, Walker, Paul (1980), in body coordinates and about the joint origins: the body's
weight and inertia enter through mass, first moment and the inertia about the joint's origin, so
that no centre of mass has to be accelerated separately.
"""

from __future__ import annotations

import functools
from typing import Any

import casadi as ca
import numpy as np

from stiffopt.dynamics.joint_axes import AxisJoint, axis_joints
from stiffopt.robot.body_tree import BodyTree
from stiffopt.symbolic import Quantity


def inverse_dynamics(tree: BodyTree) -> ca.Function:
    """Return the inverse dynamics (q, v, a), each (n,), -> tau (n,) as SX operations."""
    q, v, a = (ca.SX.sym(name, tree.n) for name in ("q", "v", "a"))
    tau = newton_euler(tree, q, v, a)
    return ca.Function("inverse_dynamics", [q, v, a], [tau], ["q", "v", "a"], ["tau"])


def newton_euler(tree: BodyTree, q: Quantity, v: Quantity, a: Quantity) -> Quantity:
    """Return the torques (n,) of joints on their links' motion, without rotor inertia and friction.

    Zeros given as constants vanish from the graph, so v = a = 0 gives the bare gravity torque.
    """
    if any(isinstance(x, ca.MX) for x in (q, v, a)):
        return inverse_dynamics(tree)(q, v, a)
    numeric = not any(isinstance(x, ca.SX) for x in (q, v, a))
    motion = ca.SX(q), ca.SX(v), ca.SX(a)
    tau = torque_of_bodies(tree, tree.gravity, *motion, *own_bodies(tree))
    return ca.DM(tau) if numeric else tau


def own_bodies(tree: BodyTree) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return masses (n,), first moments (3, n) and inertias (3, 3 n) in the axis frames."""
    joints = axis_joints(tree)
    return (
        ca.SX([joint.mass for joint in joints]),
        ca.SX(np.column_stack([joint.first_moment for joint in joints])),
        ca.SX(np.hstack([joint.inertia for joint in joints])),
    )


def torque_of_bodies(
    tree: BodyTree,
    gravity: np.ndarray,
    q: ca.SX,
    v: ca.SX,
    a: ca.SX,
    mass: ca.SX,
    first_moment: ca.SX,
    inertia: ca.SX,
) -> ca.SX:
    """Return the joint torques (n,) of other bodies on the joints of a tree, as `own_bodies`."""
    return _recursion(tree, gravity)(q, v, a, mass, first_moment, inertia)[0]


def joint_wrenches(tree: BodyTree, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    """Return force and moment (6, n) of each joint on the links that it carries.

    About the joint's origin, in its axis frame (`joint_axes`), of the links' motion alone.
    """
    return _recursion(tree, tree.gravity)(q, v, a, *own_bodies(tree))[1]


def _recursion(tree: BodyTree, gravity: np.ndarray) -> ca.Function:
    """Return the recursion of a tree, a function of motion and bodies to torques and wrenches."""
    frames = tuple(
        (j.parent, j.prismatic, j.rotation.tobytes(), j.angle_offset, j.translation.tobytes())
        for j in axis_joints(tree)
    )
    return _cached_recursion(frames, np.asarray(gravity, dtype=float).tobytes())


# Of a joint: parent, prismatic, rotation, angle_offset, translation.
_Frame = tuple[int, bool, bytes, float, bytes]


@functools.lru_cache(maxsize=64)
def _cached_recursion(frames: tuple[_Frame, ...], gravity: bytes) -> ca.Function:
    """Return the cached recursion for these frames.

    A call substitutes its expressions for the symbols; zeros and ones vanish there.
    """
    n = len(frames)
    q, v, a = (ca.SX.sym(name, n) for name in ("q", "v", "a"))
    mass, first = ca.SX.sym("mass", n), ca.SX.sym("first_moment", 3, n)
    inertia = ca.SX.sym("inertia", 3, 3 * n)
    # Symbols where a joint has numbers.
    bodies: list[dict[str, Any]] = [
        {"mass": mass[i], "first_moment": first[:, i], "inertia": inertia[:, 3 * i : 3 * i + 3]}
        for i in range(n)
    ]
    joints = tuple(
        AxisJoint(
            parent=parent,
            prismatic=prismatic,
            rotation=np.frombuffer(rotation).reshape(3, 3),
            angle_offset=offset,
            translation=np.frombuffer(translation),
            from_joint_frame=np.eye(3),
            **bodies[i],
        )
        for i, (parent, prismatic, rotation, offset, translation) in enumerate(frames)
    )
    poses = [joint_pose(joint, q[i]) for i, joint in enumerate(joints)]
    forces, moments = _outward_recursion(np.frombuffer(gravity), joints, poses, v, a)
    tau = _inward_recursion(joints, poses, forces, moments)
    # The recursion leaves the whole wrench of each joint.
    wrenches = ca.vertcat(ca.horzcat(*forces), ca.horzcat(*moments))
    return ca.Function("recursion", [q, v, a, mass, first, inertia], [tau, wrenches])


def joint_pose(joint: AxisJoint, angle: Quantity) -> tuple[Quantity, Quantity]:
    """Return rotation and origin of the joint's axis frame in its parent's."""
    rotation = ca.sparsify(ca.DM(joint.rotation))
    if joint.prismatic:
        return rotation, joint.translation + ca.SX(rotation[:, 2]) * angle
    c, s = ca.cos(angle + joint.angle_offset), ca.sin(angle + joint.angle_offset)
    turn = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
    return ca.mtimes(rotation, ca.sparsify(turn)), ca.SX(joint.translation)


def _outward_recursion(
    gravity: np.ndarray,
    joints: tuple[AxisJoint, ...],
    poses: list[tuple[Quantity, Quantity]],
    v: Quantity,
    a: Quantity,
) -> tuple[list[Quantity], list[Quantity]]:
    """Return inertial force and moment about the joint origin of each body."""
    still = ca.SX.zeros(3)
    # Gravity enters as an upward acceleration of the base.
    state = [(still, still, ca.SX(-gravity))]
    forces, moments = [], []
    for i, (joint, (rotation, origin)) in enumerate(zip(joints, poses, strict=True)):
        spin, spin_rate, acceleration = state[joint.parent]
        carried = acceleration + ca.cross(spin_rate, origin)
        carried += ca.cross(spin, ca.cross(spin, origin))
        back = rotation.T
        spin, spin_rate = ca.mtimes(back, spin), ca.mtimes(back, spin_rate)
        acceleration = ca.mtimes(back, carried)
        along_v = ca.vertcat(0, 0, v[i])
        along_a = ca.vertcat(0, 0, a[i])
        if joint.prismatic:
            acceleration += 2 * ca.cross(spin, along_v) + along_a
        else:
            spin_rate += ca.cross(spin, along_v) + along_a
            spin = spin + along_v
        state.append((spin, spin_rate, acceleration))
        first, inertia = joint.first_moment, joint.inertia
        forces.append(
            joint.mass * acceleration
            + ca.cross(spin_rate, first)
            + ca.cross(spin, ca.cross(spin, first))
        )
        moments.append(
            ca.mtimes(inertia, spin_rate)
            + ca.cross(spin, ca.mtimes(inertia, spin))
            + ca.cross(first, acceleration)
        )
    return forces, moments


def _inward_recursion(
    joints: tuple[AxisJoint, ...],
    poses: list[tuple[Quantity, Quantity]],
    forces: list[Quantity],
    moments: list[Quantity],
) -> Quantity:
    """Sum the wrenches from the tips to the base and project them on the joint axes."""
    tau = ca.SX.zeros(len(joints))
    for i in reversed(range(len(joints))):
        joint, (rotation, origin) = joints[i], poses[i]
        tau[i] = forces[i][2] if joint.prismatic else moments[i][2]
        if joint.parent:
            force = ca.mtimes(rotation, forces[i])
            moment = ca.mtimes(rotation, moments[i]) + ca.cross(origin, force)
            forces[joint.parent - 1] = forces[joint.parent - 1] + force
            moments[joint.parent - 1] = moments[joint.parent - 1] + moment
    return ca.densify(tau)
