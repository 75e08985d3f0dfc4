"""What links do beside the slow motion that predictions follow: they swing on their springs.

Motors that reverse jerk their links. Recorded motor angles hold all of that; the links' answer
follows from the springs, without any measurement of the links.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.filtering import derivative
from stiffopt.discovery.robot import RobotModel
from stiffopt.discovery.signals import RobotSignals

# Integration step [s], far below the period of any resonance of a joint.
_STEP = 5e-4
# Between inertia matrices, which change with posture only [s].
_POSTURE = 0.02
# Points of the table of a spring's law, and how far it goes beyond the torques met.
_POINTS = 4001
_BEYOND = 1.5


@dataclass(frozen=True)
class Vibration:
    """Beside the slow motion.

    Parameters
    ----------
    deflection : array (K, n)
        Added to motor minus link angle [rad].
    torque : array (K, n)
        Added to the torque between motor and link [N m].
    """

    deflection: np.ndarray
    torque: np.ndarray


def vibration(robot: RobotModel, signals: RobotSignals, position: np.ndarray) -> Vibration | None:
    """Links driven by what recorded motor angles have beside the slow motion.

    Parameters
    ----------
    robot : RobotModel
    signals : RobotSignals
        Slow motion, with the spring torques that belong to it.
    position : array (K, n)
        Motor angles, not filtered [rad].

    Returns
    -------
    Vibration or None
        None where a joint's spring or damping is not known.

    Notes
    -----
    Symplectic Euler on inertia of the posture, the nominal springs about the slow torque and the
    nominal damping. Gravity and Coriolis torques of so small a motion are left out.
    """
    damping = robot.recordings.nominal.joint_damping
    if damping is None or not all(joint.elastic for joint in robot.constants.joints):
        return None
    dt = signals.dt
    steps = max(1, round(dt / _STEP))
    h = dt / steps
    spring = _Springs(robot, signals.spring_torque)
    every = max(1, round(_POSTURE / dt))
    mobility = np.linalg.inv(robot.inertia(signals.link_position[::every]))
    fast = position - signals.motor_position
    rate = derivative(fast, dt)
    slow, carried = robot.windup(signals.spring_torque), signals.spring_torque
    swing, speed = fast[0].copy(), np.zeros(robot.n)
    deflection, torque = np.empty_like(fast), np.empty_like(fast)
    shares = np.arange(steps)[:, None] / steps
    for k in range(len(fast)):
        deflection[k] = fast[k] - swing
        torque[k] = spring(slow[k] + deflection[k]) - carried[k] + damping * (rate[k] - speed)
        if k + 1 == len(fast):
            break
        end = (1.0 - shares) * fast[k] + shares * fast[k + 1]
        moved = (1.0 - shares) * rate[k] + shares * rate[k + 1]
        wound = (1.0 - shares) * slow[k] + shares * slow[k + 1] + end
        held = (1.0 - shares) * carried[k] + shares * carried[k + 1] - damping * moved
        free = mobility[k // every] * h
        for i in range(steps):
            speed = speed + free @ (spring(wound[i] - swing) - held[i] - damping * speed)
            swing = swing + h * speed
    return Vibration(deflection, torque)


class _Springs:
    """Torques of all springs at their deflections, from even tables."""

    def __init__(self, robot: RobotModel, torque: np.ndarray) -> None:
        share = np.linspace(-1.0, 1.0, _POINTS)
        torques = share[:, None] * (_BEYOND * np.abs(torque).max(axis=0) + 1.0)
        windup = robot.windup(torques)
        self._end = windup[-1]
        self._scale = (_POINTS - 1) / (2.0 * self._end)
        self._columns = np.arange(robot.n)
        self._table = np.column_stack(
            [np.interp(share * end, windup[:, j], torques[:, j]) for j, end in enumerate(self._end)]
        )

    def __call__(self, deflection: np.ndarray) -> np.ndarray:
        place = np.clip((deflection + self._end) * self._scale, 0.0, _POINTS - 2.0)
        low = place.astype(int)
        share = place - low
        below, above = self._table[low, self._columns], self._table[low + 1, self._columns]
        return np.asarray(below + share * (above - below))
