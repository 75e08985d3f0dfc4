"""Rigid-body dynamics and kinematics of an arm along a whole motion, many instants at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.rigid_body import without_rotors


def torques_along(model: Any, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torques (K, n) of a pinocchio model for position, velocity and acceleration (K, n).

    In one call where pinocchio was built for it.
    """
    # Its transpose is what pinocchio writes to. That takes a matrix of a single row for one without
    # gaps, whatever its strides: only an array made here is safe.
    torque = np.empty(q.shape)
    if hasattr(pin, "rneaInParallel"):
        motion = (np.asarray(x, dtype=float).T for x in (q, v, a))
        pin.rneaInParallel(1, pin.ModelPool(model, 1), *motion, torque.T)
        return torque
    data = model.createData()
    for k in range(len(q)):
        torque[k] = pin.rnea(model, data, q[k], v[k], a[k])
    return torque


class BodiesInMotion:
    """Torques, their slopes and the tool along motions; no rotors, no friction.

    Parameters
    ----------
    model : pinocchio.Model
        Of revolute and prismatic joints; copied, so that later changes of it do not matter.

    Notes
    -----
    The numbers of `RigidBodies`, without a call from Python for every one of them where pinocchio
    takes many at once. Joints are in the order of the model; torques [N m] are forces [N] where a
    joint slides.
    """

    def __init__(self, model: Any) -> None:
        self._model = without_rotors(model)
        self._data = self._model.createData()

    def with_gravity(self, gravity: np.ndarray) -> BodiesInMotion:
        """The same bodies under another gravity (3,) [m/s^2], base axes."""
        changed = BodiesInMotion(self._model)
        changed._model.gravity.linear = np.asarray(gravity, dtype=float)
        return changed

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Inverse dynamics: position, velocity, acceleration (K, n) -> torque (K, n)."""
        return torques_along(self._model, q, v, a)

    def gravity_torque(self, q: np.ndarray) -> np.ndarray:
        """Torque (K, n) that holds the weight at rest."""
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

    def torque_regressor(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Torques for a unit of every inertial parameter (K, n, 10 n).

        Ten columns a body: its `Body.inertial_parameters`.
        """
        model, data = self._model, self._data
        count, n = q.shape
        found = np.empty((count, n, 10 * n))
        for k in range(count):
            # pin drops an axis for an arm of one joint.
            full = pin.computeJointTorqueRegressor(model, data, q[k], v[k], a[k])
            found[k] = np.reshape(full, (n, 10 * n))
        return found

    def tool(self, frame: LinkFrame, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position (K, 3) [m] of a frame in the base, and its Jacobian (K, 3, n), base axes."""
        model, data = self._model, self._data
        count, n = q.shape
        place, rotation = np.empty((count, 3)), np.empty((count, 3, 3))
        twists = np.empty((count, 6, n))
        for k in range(count):
            full = pin.computeJointJacobians(model, data, q[k])
            pose = data.oMi[frame.joint]
            place[k], rotation[k] = pose.translation, pose.rotation
            twists[k] = np.reshape(full, (6, n))
        position = place + rotation @ frame.offset
        # Joints behind the frame do not move it.
        carries = [j in model.supports[frame.joint] for j in range(1, n + 1)]
        linear, turning = twists[:, :3] * carries, twists[:, 3:] * carries
        return position, linear + np.cross(turning, position[:, :, None], axis=1)
