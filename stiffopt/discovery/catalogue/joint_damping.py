"""Joint damping other than nominal: vibration that decays faster or slower."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, FittedEffect, RobotChange, Term, Values
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.robot.robot import Robot


def joint_damping_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return wind-up -dD (w - v) D'(s): the damper takes part of the torque from the spring."""
    rate = signals.motor_velocity - signals.link_velocity
    slope = signals.constants.compliance(signals.spring_torque)
    return Term(deflection=-amplitudes[0] * rate * slope)


def change_damping(
    robot: Robot, found: FittedEffect, joint: int, constants: JointConstants
) -> RobotChange:
    """Return the robot with the estimated damping."""
    damping = np.full(robot.n, np.nan) if robot.damping is None else robot.damping.copy()
    before = constants.joint_damping
    damping[joint] = max(before + found.amplitudes[0], 0.0)
    return RobotChange(
        replace(robot, damping=damping),
        f"Joint {joint + 1}: damping {before:.4g} to {damping[joint]:.4g} N m s/rad.",
    )


JOINT_DAMPING = Effect(
    name="joint_damping",
    family="elastic",
    scope="joint",
    equation="d += -dD*(w - v)*D'(s)",
    signature="vibration after sharp motion that decays faster or slower than nominal, at the"
    " frequency that the model has",
    title="joint damping",
    nominal="joint_damping",
    phrase=("{dD} more joint damping than the model", "{dD} less joint damping than the model"),
    remedy="Enter joint damping {new} for {where}.",
    needs=("windup", "moves"),
    confused_with=("hysteresis",),
    change_robot=change_damping,
    term=joint_damping_term,
    amplitudes=(
        Amplitude("dD", "N m s/rad", lambda constants: constants.joint_damping, -1.0, 20.0),
    ),
    # Without a damping value links are modelled quasi-static.
    applies=lambda constants: constants.elastic and constants.joint_damping > 0.0,
    separate="Stop sharply and stand still for a second, with and without load: damping takes the"
    " same share of every period, hysteresis most of small ones, a soft joint vibrates slower.",
)
