"""Linear model of an arm in poses and along a motion, linear in the payload, and its springs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.elastic.arm import ElasticArm

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

_SPRING_TABLE_POINTS = 20001  # of each joint's law, equidistant in wind-up


class LinearizedBodies:
    """Linearised bodies at instants of a motion: first all bodies, then the payload alone.

    Parameters
    ----------
    arm : ElasticArm
    q, v, a : array (K, n)
        Motion of the links, point of linearisation.

    Attributes
    ----------
    by_q, by_v, inertia : array (2, K, n, n)
        Derivatives of the torque by position, velocity and acceleration.
    """

    def __init__(self, arm: ElasticArm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        whole = [
            robot.bodies_in_motion().torque_slopes(q, v, a)
            for robot in _robot_and_heavier_payload(arm)
        ]
        self.by_q, self.by_v, self.inertia = _split_payload(whole)


class LinearizedWeight:
    """Linearised weight in poses (K, n): first all bodies, then the payload alone.

    Attributes
    ----------
    torque : array (2, K, n)
        Static spring torque [N m].
    by_q : array (2, K, n, n)
        Derivative by position.
    """

    def __init__(self, arm: ElasticArm, q: np.ndarray) -> None:
        whole = []
        for robot in _robot_and_heavier_payload(arm):
            bodies = robot.rigid_bodies()
            weight = np.array([bodies.gravity_torque(row) for row in q])
            whole.append((weight, np.array([bodies.weight_slope(row) for row in q])))
        self.torque, self.by_q = _split_payload(whole)
        self.torque[0] -= arm.force_torque(q)


def _robot_and_heavier_payload(arm: ElasticArm) -> list[Robot]:
    robot = arm.robot
    return [robot] if robot.payload is None else [robot, robot.with_payload_times(2.0)]


def _split_payload(whole: Sequence[tuple[np.ndarray, ...]]) -> list[np.ndarray]:
    heavier = whole[-1]
    return [np.stack([own, more - own]) for own, more in zip(whole[0], heavier, strict=True)]


def plan_torques(arm: ElasticArm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Inverse dynamics (2, K, n) of a motion less the torque of the process force [N m].

    First of all bodies, then of the payload alone.
    """
    whole = [
        (robot.bodies_in_motion().torque(q, v, a),) for robot in _robot_and_heavier_payload(arm)
    ]
    (torque,) = _split_payload(whole)
    torque[0] -= arm.force_torque(q)
    return torque


class TabulatedSprings:
    """Springs of all joints tabulated on equidistant wind-ups; zero for rigid joints."""

    def __init__(self, arm: ElasticArm) -> None:
        self._arm, self._half = arm, (_SPRING_TABLE_POINTS - 1) // 2
        reach = np.array([1.0 if s is None else s.windup_reach for s in arm.springs])
        windups = np.linspace(-reach, reach, _SPRING_TABLE_POINTS)
        table = np.array(
            [
                np.zeros(_SPRING_TABLE_POINTS) if spring is None else spring.torque(windup)
                for spring, windup in zip(arm.springs, windups.T, strict=True)
            ]
        )
        self._scale = self._half / reach
        self._torque, self._rise = table.ravel(), np.diff(table, append=table[:, -1:]).ravel()
        self._offset = _SPRING_TABLE_POINTS * np.arange(len(reach))

    def table(self) -> dict[str, np.ndarray | int]:
        """Torques and differences to the next point (n points,), points per radian (n,)."""
        numbers = {"torque": self._torque, "rise": self._rise, "scale": self._scale}
        return {**numbers, "points": _SPRING_TABLE_POINTS}

    def at(self, windup: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques [N m] and tangent stiffnesses [N m/rad] at wind-ups, (B, n) each."""
        place = windup * self._scale + self._half
        # Linear extrapolation beyond the table.
        cell = np.minimum(np.maximum(place.astype(np.int64), 0), 2 * self._half - 1)
        at = cell + self._offset
        rise = self._rise[at]
        return self._torque[at] + (place - cell) * rise, rise * self._scale

    def torque(self, windup: np.ndarray) -> np.ndarray:
        """Torques [N m] at wind-ups, (B, n) each."""
        return self.at(windup)[0]

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Wind-ups [rad] at torques, (.., n) each; the inverse of `torque`."""
        return self._arm.windup(torque.reshape(-1, torque.shape[-1])).reshape(torque.shape)
