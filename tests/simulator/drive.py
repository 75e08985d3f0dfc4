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
        self._reference = world.reference
        self._speed = np.gradient(world.reference, h, axis=1)
        self._feed = world.nominal_torque
        self._stride = world.spec.substeps
        self._limit = robot.torque_max
        self._count = robot.motor_count
        self._h, self._mix = h, 1.0 - np.exp(-FILTER * h)
        self._last = self._counted(world.reference[:, 0])
        self._velocity = np.zeros_like(self._last)

    def _counted(self, angle: np.ndarray) -> np.ndarray:
        return np.asarray(np.round(angle / self._count) * self._count)

    def first(self) -> np.ndarray:
        return self._feed[:, 0].copy()

    def next(self, step: int, motor: np.ndarray) -> np.ndarray:
        """Torque [N m] for the step after this one."""
        seen = self._counted(motor)
        self._velocity += self._mix * ((seen - self._last) / self._h - self._velocity)
        self._last = seen
        row, part = divmod(step, self._stride)
        following = min(row + 1, self._feed.shape[1] - 1)
        share = part / self._stride
        feed = (1 - share) * self._feed[:, row] + share * self._feed[:, following]
        asked = (
            feed
            + self._stiff * (self._reference[:, step] - seen)
            + self._damp * (self._speed[:, step] - self._velocity)
        )
        return np.clip(asked, -self._limit, self._limit)
