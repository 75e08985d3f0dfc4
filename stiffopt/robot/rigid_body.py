"""Rigid-body dynamics and kinematics of an arm in numbers: one instant, or whole motions."""

from __future__ import annotations

import ctypes
from functools import cached_property
from typing import Any, Self

import numpy as np
import pinocchio as pin

from stiffopt import native
from stiffopt.native import ARRAY, WHOLE, Struct
from stiffopt.robot.body_tree import BodyTree, body_tree
from stiffopt.robot.frames import LinkFrame

# Joints that the C code has room for.
MAX_JOINTS = 32
# Instants from which it is faster than pinocchio, and of which copies are made at once.
MIN_INSTANTS, _MAX_COPIED = 16, 2**14


class _Bodies(Struct):
    _fields_ = (
        ("n", WHOLE),
        *((name, ARRAY) for name in ("parent", "slides", "axis", "rotation", "translation")),
        *((name, ARRAY) for name in ("inertial", "gravity")),
    )


class NativeBodies:
    """An arm's bodies as the compiled loop takes them.

    `inertial` (n, 10): in place of the bodies' own, in the order of `Body.inertial_parameters`; of
    bodies that need not exist by themselves.
    """

    def __init__(self, tree: BodyTree, inertial: np.ndarray | None = None) -> None:
        self._tree, self._n = tree, tree.n
        if inertial is None:
            inertial = np.array([body.inertial_parameters for body in tree.bodies])
        self._own = _Bodies()
        self._own.set(
            n=self._n,
            parent=[body.parent for body in tree.bodies],
            slides=[body.prismatic for body in tree.bodies],
            inertial=np.asarray(inertial, dtype=float),
            gravity=np.asarray(tree.gravity, dtype=float),
            **{
                name: np.array([getattr(body, name) for body in tree.bodies], dtype=float)
                for name in ("axis", "rotation", "translation")
            },
        )

    def with_parameters(self, inertial: np.ndarray) -> NativeBodies:
        """The same joints with other inertial parameters (n, 10)."""
        return NativeBodies(self._tree, inertial)

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray | None:
        """Torques (K, n) along a motion (K, n) each; None where pinocchio is to compute them."""
        if len(q) < MIN_INSTANTS or self._n > MAX_JOINTS or (core := native.loaded()) is None:
            return None
        torque = np.empty(q.shape)
        for begin in range(0, len(q), _MAX_COPIED):
            part = torque[begin : begin + _MAX_COPIED]
            motion = [
                np.ascontiguousarray(x[begin : begin + _MAX_COPIED], dtype=float) for x in (q, v, a)
            ]
            core.inverse(
                ctypes.byref(self._own),
                WHOLE(len(part)),
                *(ARRAY(x.ctypes.data) for x in (*motion, part)),
            )
        return torque


def without_rotors(model: Any) -> Any:
    """Copy a pinocchio model without rotor inertia."""
    bodies = model.copy()
    # The rotor is on the motor side of the spring and loads only the drive.
    bodies.armature = np.zeros(model.nv)
    return bodies


class _Links:
    """Own copy of a pinocchio model without its rotors."""

    def __init__(self, model: Any) -> None:
        self._model = without_rotors(model)
        self._data = self._model.createData()

    def with_gravity(self, gravity: np.ndarray) -> Self:
        """Copy under another gravity (3,) [m/s^2], base axes."""
        changed = type(self)(self._model)
        changed._model.gravity.linear = np.asarray(gravity, dtype=float)
        return changed


class RigidBodies(_Links):
    """Torques, inertia and poses of links and payload; no rotors, no friction.

    `model`: model of revolute and prismatic joints; copied. Joints are in the order of the model;
    torques [N m] of prismatic joints are forces [N].
    """

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Inverse dynamics: position, velocity, acceleration (n,) -> torque (n,)."""
        return np.array(pin.rnea(self._model, self._data, q, v, a))

    def acceleration(self, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Forward dynamics: position, velocity, torque (n,) -> acceleration (n,)."""
        return np.array(pin.aba(self._model, self._data, q, v, torque))

    def gravity_torque(self, q: np.ndarray) -> np.ndarray:
        """Gravity torque (n,)."""
        return np.array(pin.computeGeneralizedGravity(self._model, self._data, q))

    def inertia_matrix(self, q: np.ndarray) -> np.ndarray:
        """Joint-space inertia matrix (n, n) [kg m^2]."""
        return np.array(pin.crba(self._model, self._data, q))

    def torque_slopes(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives (n, n) of `torque` by position, velocity and acceleration."""
        model, data = self._model, self._data
        pin.computeRNEADerivatives(model, data, q, v, a)
        upper = np.triu(data.M)
        inertia = upper + np.triu(upper, 1).T
        return np.array(data.dtau_dq), np.array(data.dtau_dv), inertia

    def weight_slope(self, q: np.ndarray) -> np.ndarray:
        """Derivative (n, n) of `gravity_torque` by position."""
        return np.array(pin.computeGeneralizedGravityDerivatives(self._model, self._data, q))

    def pose(self, frame: LinkFrame, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) [m] and rotation (3, 3) of a frame in the base, or in `seen_from`."""
        pin.forwardKinematics(self._model, self._data, q)
        found = self._placement(frame)
        if frame.seen_from is not None:
            found = self._placement(frame.seen_from).actInv(found)
        return np.array(found.translation), np.array(found.rotation)

    def jacobian(self, frame: LinkFrame, q: np.ndarray) -> np.ndarray:
        """Jacobian (6, n) of velocity and angular velocity of a frame, base axes or `seen_from`."""
        pin.computeJointJacobians(self._model, self._data, q)
        found = self._moved_with(frame.joint, pin.SE3(frame.rotation, frame.offset))
        if frame.seen_from is None:
            return found
        # The work moves by the Jacobian of its point at the frame's origin.
        at = self._data.oMi[frame.seen_from.joint].actInv(self._placement(frame))
        found -= self._moved_with(frame.seen_from.joint, at)
        axes = self._placement(frame.seen_from).rotation.T
        return np.vstack([axes @ found[:3], axes @ found[3:]])

    def _placement(self, frame: LinkFrame) -> pin.SE3:
        return self._data.oMi[frame.joint] * pin.SE3(frame.rotation, frame.offset)

    def _moved_with(self, joint: int, at: pin.SE3) -> np.ndarray:
        """Jacobian (6, n) of a frame at a place of a joint, base axes."""
        full = pin.getFrameJacobian(self._model, self._data, joint, at, pin.LOCAL_WORLD_ALIGNED)
        # pinocchio drops the second axis for an arm of one joint.
        return np.array(full).reshape(6, self._model.nv)


def inverse_dynamics_along(model: Any, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torques (K, n) of a pinocchio model for position, velocity and acceleration (K, n)."""
    # pinocchio writes to the transpose and ignores the strides of a single row: the array must be
    # allocated here.
    torque = np.empty(q.shape)
    if hasattr(pin, "rneaInParallel"):
        motion = (np.asarray(x, dtype=float).T for x in (q, v, a))
        pin.rneaInParallel(1, pin.ModelPool(model, 1), *motion, torque.T)
        return torque
    data = model.createData()
    for k in range(len(q)):
        torque[k] = pin.rnea(model, data, q[k], v[k], a[k])
    return torque


class BodiesInMotion(_Links):
    """Torques along motions and their derivatives; no rotors, no friction.

    `model`: model of revolute and prismatic joints; copied. The values of `RigidBodies`, without a
    Python call per instant where compiled code or pinocchio evaluates many at a time. Joints are in
    the order of the model; torques [N m] of prismatic joints are forces [N].
    """

    @cached_property
    def _native_bodies(self) -> NativeBodies:
        return NativeBodies(body_tree(self._model))

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Inverse dynamics: position, velocity, acceleration (K, n) -> torque (K, n)."""
        found = self._native_bodies.torque(q, v, a)
        return inverse_dynamics_along(self._model, q, v, a) if found is None else found

    def gravity_torque(self, q: np.ndarray) -> np.ndarray:
        """Gravity torque (K, n)."""
        rest = np.zeros(q.shape)
        return self.torque(q, rest, rest)

    def torque_slopes(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives (K, n, n) of `torque` by position, velocity and acceleration."""
        model, data = self._model, self._data
        count, n = q.shape
        position, velocity, upper = (np.empty((count, n, n)) for _ in range(3))
        for k in range(count):
            pin.computeRNEADerivatives(model, data, q[k], v[k], a[k])
            position[k], velocity[k], upper[k] = data.dtau_dq, data.dtau_dv, data.M
        inertia = np.triu(upper)
        return position, velocity, inertia + np.triu(upper, 1).swapaxes(1, 2)

    def changed_torque(
        self, change: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> np.ndarray:
        """Change (K, n) of the torques by a change (n, 10) of inertial parameters.

        `change` (n, 10): in the order of `Body.inertial_parameters`; need not be those of a
        physical body. `q`, `v` and `a` (K, n).
        """
        found = self._native_bodies.with_parameters(change).torque(q, v, a)
        if found is not None:
            return found
        torques = []
        for times in (1.0, 0.0):
            model = self._model.copy()
            for body, values in enumerate(change, start=1):
                # Added to a mass large enough for a positive total.
                whole = times * values
                whole[0] += 1.0 + abs(values[0])
                model.inertias[body] = pin.Inertia.FromDynamicParameters(whole)
            torques.append(inverse_dynamics_along(model, q, v, a))
        return np.asarray(torques[0] - torques[1])
