"""Elastic bearings of an arm: joints of their own, without a motor, and the lead against them.

A bearing has no motor: the driven joints move the tool back onto its path, quasi-static, in all
directions that they reach, so that six joints correct position and orientation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.elastic.arm import ASSUMED_DAMPING, ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.elastic.springs import JointSpring
from stiffopt.elastic.uncertainty import Departure
from stiffopt.result.trajectory import JointMotion, Trajectory
from stiffopt.robot.bearings import (
    correcting_joints,
    dynamic_bearing_deflections,
    with_bearing_joints,
)


class BearingJoints:
    """An arm with the joints of its bearings among those of its motors.

    Parameters
    ----------
    arm : ElasticArm
    start : array (n,)
        Position of the motors at rest, where fast joints are judged.

    Attributes
    ----------
    arm : ElasticArm
        Of m joints; the springs of bearings have 2 % of their critical damping. Components that
        vibrate too fast to matter are rigid.
    driven : array (n,)
        Joints with a motor.
    """

    def __init__(self, arm: ElasticArm, start: np.ndarray) -> None:
        robot, stiffness = with_bearing_joints(arm.robot)
        self.driven = np.flatnonzero(stiffness == 0.0)
        laws = tuple(each.moved(self.driven.tolist()) for each in arm.robot.added_torques)
        robot = replace(robot, added_torques=laws)
        self._places = np.searchsorted(self.driven, np.arange(robot.n), side="right") - 1
        at = self.spread(np.asarray(start, dtype=float))
        found = ElasticArm(robot, at, arm.process_force)
        driven = iter(arm.springs)
        found.springs = tuple(
            JointSpring.linear(own) if own else next(driven) for own in stiffness.tolist()
        )
        found.path_force = arm.path_force
        found.elastic = np.array([spring is not None for spring in found.springs])
        inertia = np.diag(found.bodies.inertia_matrix(at))
        found.damping = 2.0 * ASSUMED_DAMPING * np.sqrt(stiffness * inertia)
        for name in ("damping", "hysteresis"):
            getattr(found, name)[self.driven] = getattr(arm, name)
        found.assumed_damping = tuple(int(self.driven[j - 1]) + 1 for j in arm.assumed_damping)
        self.arm = found.with_fast_joints_following(at)

    def spread(self, values: np.ndarray, others: float = 0.0) -> np.ndarray:
        """Values (..., m) of all joints from those (..., n) of the motors."""
        found = np.full((*values.shape[:-1], len(self._places)), others)
        found[..., self.driven] = values
        return found

    def motion(self, motors: JointMotion) -> MotorMotion:
        """Motion of all joints: bearings are held at rest where they are not loaded."""
        own = MotorMotion.of(motors) if not isinstance(motors, MotorMotion) else motors
        position, velocity = (self.spread(own(own.time, order)) for order in (0, 1))
        return MotorMotion(own.time, position, velocity, own.duration)

    def departure(self, departure: Departure) -> Departure:
        """Return the departure with the factors of the bearings' springs among the stiffnesses."""
        bearings = np.broadcast_to(departure.bearings, len(self.driven))[self._places]
        stiffness = np.array(bearings, dtype=float)
        stiffness[self.driven] = departure.stiffness
        return replace(departure, stiffness=stiffness, bearings=1.0)


# Knot spacing of the lead [s]: slow beside the bearings' modes, for which it does not account. With
# 10 ms a quintic motion of the ER3A rings three times as much after arrival, with 40 ms an arm
# that moves for 0.5 s keeps half of the deflection.
_KNOT_SPACING = 0.02


def bearing_lead(arm: ElasticArm, plan: JointMotion) -> Trajectory:
    """Return the motion of the joints that leads the tool against the yielding of the bearings.

    `plan`: of the links, at rest at both ends.
    """
    return smooth_motion(_BearingLead(arm, plan), _KNOT_SPACING)


class LedPlan:
    """Motion of the links that leads a plan, at the same times."""

    def __init__(self, plan: JointMotion, lead: JointMotion) -> None:
        self.duration, self._plan, self._lead = plan.duration, plan, lead

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Evaluate position (order 0) or a derivative (K, n) at times (K,)."""
        return np.asarray(self._plan(t, order) + self._lead(t, order))


class _BearingLead:
    """Lead at any time, without derivatives."""

    def __init__(self, arm: ElasticArm, plan: JointMotion) -> None:
        self.duration, self._arm, self._plan = plan.duration, arm, plan

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        assert order == 0
        q, v, a = (np.array(self._plan(t, k)) for k in range(3))
        # Ends are at rest, where the sag is calibrated away.
        v[[0, -1]] = a[[0, -1]] = 0.0
        arm, force = self._arm, self._arm.path_force
        beside = None if force is None else force(t)
        away = dynamic_bearing_deflections(arm.robot, q, v, a, arm.process_force, beside)
        return correcting_joints(arm.robot, q, away.sum(axis=1))
