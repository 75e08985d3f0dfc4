"""The drives: feed-forward of the nominal robot and a position loop on counted encoders."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .world import World

BANDWIDTH = 2 * np.pi * 4.0  # of the position loop [rad/s]
DAMPING = 0.8
FILTER = 2 * np.pi * 90.0  # of the velocity from counts [rad/s]


class Controller:
    """Torque asked of every drive, from what its encoder said one step before."""

    def __init__(self, world: World) -> None:
        robot, h = world.robot, world.step
        model = robot.model()
        inertia = np.diag(pin.crba(model, model.createData(), robot.centre)) + robot.rotor_inertia
        self._stiff = inertia * BANDWIDTH**2
        self._damp = 2 * DAMPING * inertia * BANDWIDTH
        speed = np.gradient(world.reference, h, axis=1)
        # All of the law that does not wait for the encoders, time first.
        asked = self._between(world.nominal_torque, world.spec.substeps, world.reference.shape[1])
        asked += self._stiff * world.reference + self._damp * speed
        self._asked = np.ascontiguousarray(asked.swapaxes(0, 1))
        self._first = world.nominal_torque[:, 0].copy()
        self._limit = robot.torque_max
        self._count = robot.motor_count
        self._mix = 1.0 - np.exp(-FILTER * h)
        self._rate = self._mix / h
        self._last = self._counted(world.reference[:, 0])
        self._velocity = np.zeros_like(self._last)

    @staticmethod
    def _between(coarse: np.ndarray, stride: int, steps: int) -> np.ndarray:
        """Values at every step from those at every stride-th."""
        row, part = np.divmod(np.arange(steps), stride)
        after = np.minimum(row + 1, coarse.shape[1] - 1)
        share = (part / stride)[:, None]
        return np.asarray((1 - share) * coarse[:, row] + share * coarse[:, after])

    def _counted(self, angle: np.ndarray) -> np.ndarray:
        return np.asarray(np.rint(angle / self._count) * self._count)

    def first(self) -> np.ndarray:
        return self._first

    def next(self, step: int, motor: np.ndarray) -> np.ndarray:
        """Torque [N m] for the step after this one."""
        seen = self._counted(motor)
        self._velocity += self._rate * (seen - self._last) - self._mix * self._velocity
        self._last = seen
        asked = self._asked[step] - self._stiff * seen - self._damp * self._velocity
        return np.asarray(np.minimum(np.maximum(asked, -self._limit), self._limit))
