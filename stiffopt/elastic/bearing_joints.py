"""Elastic arm whose output bearings are joints of their own, which no motor drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.elastic.arm import ASSUMED_DAMPING, ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.springs import JointSpring
from stiffopt.elastic.uncertainty import Departure
from stiffopt.result.trajectory import JointMotion
from stiffopt.robot.bearing_joints import with_bearing_joints


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
        for name in ("damping", "hysteresis", "reversal_torque"):
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
