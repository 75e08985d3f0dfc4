"""What links do beside the slow motion that predictions follow: they swing on their springs.

Motors that reverse jerk their links. Recorded motor angles hold all of that; the links' answer
follows from the springs, without any measurement of the links.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter, derivative
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepare import PreparedRun

# Integration step [s], far below the period of any resonance of a joint.
_STEP = 5e-4
# Between inertia matrices, which change with posture only [s].
_POSTURE = 0.02
# Of what links are taken to follow at the beginning, without swing [Hz].
_BEGIN = 10.0
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


def posture_step(dt: float) -> int:
    """Samples between inertia matrices."""
    return max(1, round(_POSTURE / dt))


def vibration(
    robot: RobotModel,
    run: PreparedRun,
    position: np.ndarray,
    stiffer: np.ndarray,
    added: np.ndarray,
) -> Vibration | None:
    """Links driven by what recorded motor angles have beside the slow motion.

    Parameters
    ----------
    robot : RobotModel
    run : PreparedRun
        Slow motion, with the spring torques and the wind-up that belong to it; what an extension
        added to them takes part.
    position : array (K, n)
        Motor angles, not filtered [rad].
    stiffer : array (K, n)
        Slope of the springs at the slow torque with what was found over the nominal one.
    added : array (m, n, n)
        To the nominal inertia matrices of every `posture_step` samples [kg m^2].

    Returns
    -------
    Vibration or None
        None where the swing grows beyond all bounds: the model is then none of swinging links.

    Notes
    -----
    Link angle less the slow one, s, follows M s" = K(d - s) - T + D (d - s)', with d what motor
    angles have beside slow link and slow wind-up, and T the torque of the slow motion, which need
    not be in balance. Symplectic Euler on inertia of the posture, nominal damping and nominal
    springs that are as soft as the extended ones at the slow torque. It begins without swing where
    the filter of the slow motion reaches no end. Gravity and Coriolis torques of so small a motion
    are left out.
    """
    damping = robot.recordings.nominal.joint_damping
    signals, dt = run.signals, run.signals.dt
    steps = max(1, round(dt / _STEP))
    h = dt / steps
    spring = _Springs(robot, signals.spring_torque)
    every = posture_step(dt)
    mobility = np.linalg.inv(robot.inertia(signals.link_position[::every]) + added)
    carried = signals.spring_torque
    slow = robot.windup(carried)
    driven = position - signals.link_position - signals.windup
    rate = derivative(driven + signals.windup, dt)
    deflection, torque = np.zeros_like(driven), np.zeros_like(driven)
    shares = np.arange(steps)[:, None] / steps
    begin = min(run.settling, len(driven) - 1)
    swing = driven[begin].copy()
    speed = derivative(ZeroPhaseFilter(1.0 / dt, min(_BEGIN, 0.2 / dt)).motion(driven), dt)[begin]
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(begin, len(driven)):
            deflection[k] = driven[k] - swing
            wound = slow[k] + stiffer[k] * deflection[k]
            torque[k] = spring(wound) - carried[k] + damping * (rate[k] - speed)
            if k + 1 == len(driven):
                break
            scale = stiffer[k]
            apart = slow[k] + scale * driven[k]
            apart = apart + shares * (slow[k + 1] + scale * driven[k + 1] - apart)
            moved = rate[k] + shares * (rate[k + 1] - rate[k])
            held = carried[k] + shares * (carried[k + 1] - carried[k]) - damping * moved
            free = mobility[k // every] * h
            for i in range(steps):
                speed = speed + free @ (
                    spring(apart[i] - scale * swing) - held[i] - damping * speed
                )
                swing = swing + h * speed
    if not (np.isfinite(deflection).all() and np.isfinite(torque).all()):
        return None
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
        place = np.nan_to_num((deflection + self._end) * self._scale)
        place = np.clip(place, 0.0, _POINTS - 2.0)
        low = place.astype(int)
        share = place - low
        below, above = self._table[low, self._columns], self._table[low + 1, self._columns]
        return np.asarray(below + share * (above - below))
