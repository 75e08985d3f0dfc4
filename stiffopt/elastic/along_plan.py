"""An arm linearised along a planned motion, its springs tabulated evenly: for many arms at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.elastic.arm import ElasticArm

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

_POINTS = 20001


class BodiesAlong:
    """Links and payload about instants of a motion: quantities of all bodies, then of the payload.

    Parameters
    ----------
    arm : ElasticArm
    q, v, a : array (K, n)
        Motion of the links about which is linearised.

    Attributes
    ----------
    torque : array (2, K, n)
        Needed for the motion, less what the process force does [N m].
    by_q, by_v, inertia : array (2, K, n, n)
        Its derivatives by position, velocity and acceleration.
    """

    def __init__(self, arm: ElasticArm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        whole = [_dynamics(robot, q, v, a) for robot in _robots(arm)]
        self.torque, self.by_q, self.by_v, self.inertia = _with_payload(whole)
        self.torque[0] -= [arm.force_torque(row) for row in q]


class WeightAlong:
    """Weight of links and payload in poses (K, n), in the same parts.

    Attributes
    ----------
    held : array (2, K, n)
        Torque in the springs at rest [N m].
    by_q : array (2, K, n, n)
        Its derivative by position.
    """

    def __init__(self, arm: ElasticArm, q: np.ndarray) -> None:
        whole = []
        for robot in _robots(arm):
            bodies = robot.rigid_bodies()
            weight = np.array([bodies.gravity_torque(row) for row in q])
            whole.append((weight, np.array([bodies.weight_slope(row) for row in q])))
        self.held, self.by_q = _with_payload(whole)
        self.held[0] -= [arm.force_torque(row) for row in q]


def _robots(arm: ElasticArm) -> list[Robot]:
    """The robot, and with its payload twice."""
    robot = arm.robot
    return [robot] if robot.payload is None else [robot, robot.with_payload_times(2.0)]


def _with_payload(whole: Sequence[tuple[np.ndarray, ...]]) -> list[np.ndarray]:
    """Of all bodies and of the payload alone, (2, ...)."""
    heavier = whole[-1]
    return [np.stack([own, more - own]) for own, more in zip(whole[0], heavier, strict=True)]


def _dynamics(robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, ...]:
    bodies = robot.bodies_in_motion()
    return bodies.torque(q, v, a), *bodies.torque_slopes(q, v, a)


class EvenSprings:
    """Springs of all joints on even grids of wind-ups; rigid joints have none and no wind-up.

    Parameters
    ----------
    arm : ElasticArm
    """

    def __init__(self, arm: ElasticArm) -> None:
        self._arm, self._half = arm, (_POINTS - 1) // 2
        reach = np.array([1.0 if s is None else s.windup_reach for s in arm.springs])
        windups = np.linspace(-reach, reach, _POINTS)
        table = np.array(
            [
                np.zeros(_POINTS) if spring is None else spring.torque(windup)
                for spring, windup in zip(arm.springs, windups.T, strict=True)
            ]
        )
        self._scale = self._half / reach
        self._torque, self._rise = table.ravel(), np.diff(table, append=table[:, -1:]).ravel()
        self._offset = _POINTS * np.arange(len(reach))

    def table(self) -> dict[str, np.ndarray | int]:
        """Torques and their rises to the next point (n points,), points in a radian (n,)."""
        numbers = {"torque": self._torque, "rise": self._rise, "scale": self._scale}
        return {**numbers, "points": _POINTS}

    def at(self, windup: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques [N m] and tangent stiffnesses [N m/rad] at wind-ups, (B, n) each."""
        place = windup * self._scale + self._half
        # Beyond the table the spring goes on straight.
        cell = np.minimum(np.maximum(place.astype(np.int64), 0), 2 * self._half - 1)
        at = cell + self._offset
        rise = self._rise[at]
        return self._torque[at] + (place - cell) * rise, rise * self._scale

    def torque(self, windup: np.ndarray) -> np.ndarray:
        """Torques [N m] at wind-ups, (B, n) each."""
        return self.at(windup)[0]

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Wind-ups at torques, (.., n) each; the inverse."""
        return self._arm.windup(torque.reshape(-1, torque.shape[-1])).reshape(torque.shape)
