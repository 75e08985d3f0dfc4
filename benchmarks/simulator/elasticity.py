"""Wind-up of a joint as a table of torque over deflection, and its history-dependent parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .robots import Robot

POINTS = 4001


@dataclass
class Windup:
    """What one joint's compliance is made of: pieces in series, each torque -> deflection."""

    slopes: np.ndarray  # K1, K2, K3
    corners: np.ndarray  # T1, T2
    contact: float
    factor: float = 1.0  # stiffness of the whole over the nominal one
    gap: float = 0.0  # full width of the play [rad]
    series: list[Callable[[np.ndarray], np.ndarray]] = field(default_factory=list)

    def deflection(self, torque: np.ndarray) -> np.ndarray:
        """Deflection without the play [rad]."""
        size, corner = np.abs(torque), self.corners
        reducer = (
            np.minimum(size, corner[0]) / self.slopes[0]
            + np.clip(size - corner[0], 0.0, corner[1] - corner[0]) / self.slopes[1]
            + np.maximum(size - corner[1], 0.0) / self.slopes[2]
        )
        total = np.sign(torque) * (reducer + size / self.contact)
        for piece in self.series:
            total = total + piece(torque)
        return total / self.factor


def nominal_windups(robot: Robot) -> list[Windup]:
    return [
        Windup(robot.slopes[:, j].copy(), robot.corners[:, j].copy(), robot.contact_stiffness[j])
        for j in range(robot.joints)
    ]


class SpringTable:
    """Torque of all joints over their deflections, by linear interpolation on a fine grid."""

    def __init__(self, windups: list[Windup], torque_max: np.ndarray) -> None:
        joints = len(windups)
        self._limit = np.empty(joints)
        rows = []
        for j, windup in enumerate(windups):
            torque = np.linspace(-2.0, 2.0, 20001) * torque_max[j]
            deflection = windup.deflection(torque)
            self._limit[j] = deflection[-1] + windup.gap / 2
            grid = np.linspace(-self._limit[j], self._limit[j], POINTS)
            # Inside the play the torque is zero; outside the curve begins at the edge of it.
            beyond = np.sign(grid) * np.maximum(np.abs(grid) - windup.gap / 2, 0.0)
            rows.append(np.interp(beyond, deflection, torque))
        self._flat = np.concatenate(rows)
        self._base = np.arange(joints) * POINTS
        self._per_step = (POINTS - 1) / (2 * self._limit)

    def torque(self, deflection: np.ndarray) -> np.ndarray:
        """(..., n) [rad] -> (..., n) [N m]; beyond the grid the last slope goes on."""
        place = (deflection + self._limit) * self._per_step
        cell = np.minimum(np.maximum(place.astype(np.int64), 0), POINTS - 2)
        index = cell + self._base
        low = self._flat[index]
        return low + (place - cell) * (self._flat[index + 1] - low)


class Sliders:
    """Friction inside a spring: sliders in parallel that yield one after the other (Iwan).

    All are equally strong; their yield deflections are spread evenly over the pre-sliding range,
    so that the loop closes exactly and remembers its reversals.
    """

    def __init__(self, joint: int, height: float, reach: float, count: int = 10) -> None:
        self.joint = joint
        self._strength = height / count
        self._stiffness = self._strength / (reach * (np.arange(count) + 0.5) / count)
        self._force: np.ndarray | None = None
        self._last: np.ndarray | None = None

    def add(self, deflection: np.ndarray, torque: np.ndarray) -> None:
        """Add the sliders' torque, (runs, n) both."""
        here = deflection[:, self.joint]
        if self._force is None or self._last is None:
            self._force = np.zeros((len(here), len(self._stiffness)))
            self._last = here.copy()
        self._force += (here - self._last)[:, None] * self._stiffness
        np.clip(self._force, -self._strength, self._strength, out=self._force)
        self._last = here.copy()
        torque[:, self.joint] += self._force.sum(axis=1)


class Creep:
    """Slow part of a compliance: two elements of a Prony chain, exact over a step."""

    def __init__(self, joint: int, compliance: float, time: float, step: float) -> None:
        self.joint = joint
        self._share = np.array([0.5, 0.5]) * compliance
        self._decay = np.exp(-step / (time * np.array([0.6, 1.0 / 0.6])))
        self._state: np.ndarray | None = None

    def settle(self, torque: np.ndarray) -> None:
        """Begin as if the torque (runs, n) had acted for ever."""
        self._state = torque[:, self.joint, None] * self._share

    def deflection(self, runs: int) -> np.ndarray:
        if self._state is None:
            self._state = np.zeros((runs, 2))
        return self._state.sum(axis=1)

    def advance(self, torque: np.ndarray) -> None:
        target = torque[:, self.joint, None] * self._share
        self._state = target + (self._state - target) * self._decay
