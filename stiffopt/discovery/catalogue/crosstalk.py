"""Crosstalk: the torque reading of a joint contains a share of another joint's torque."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointConstants, RobotSignals

# Typical share of the other torque; and joints of an arm that are tried.
_TYPICAL_SHARE, _MAX_JOINTS = 0.05, 12


def crosstalk_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return a share of the drive torque of another joint, whose number is the shape.

    Between whole numbers the weights of both joints fade smoothly.
    """
    drive, own = np.asarray(signals.drive_torque), signals.link
    joints = np.arange(1, drive.shape[1] + 1)
    weights = 0.5 * (1.0 + np.cos(np.pi * np.fmin(np.abs(shapes[0] - joints), 1.0)))
    weights[own] = 0.0
    return Term(drive_torque=amplitudes[0] * np.outer(drive @ weights, joints == own + 1))


def _other_joints(constants: JointConstants) -> tuple[float, ...]:
    every = range(1, min(constants.joints, _MAX_JOINTS) + 1)
    return tuple(float(joint) for joint in every if joint != constants.joint) or (1.0,)


def _describe_remedy(amplitudes: Values, shapes: Values, constants: JointConstants) -> str:
    return (
        f"The torque of joint {constants.joint} contains {100.0 * amplitudes[0]:.1f} % of that of"
        f" joint {shapes[0]:.0f}: check the wiring and the assignment of both torque channels, or"
        f' write "" for joint {constants.joint} as torque in [signals] of recordings.toml to leave'
        " it out."
    )


CROSSTALK = Effect(
    name="crosstalk",
    family="sensor",
    scope="joint",
    couples_joints=True,
    equation="tau_j += c*tau_k",
    signature="motor torque of one joint off in proportion to the torque of another, its friction"
    " included",
    phrase="torque of another joint in the reading",
    needs=("torque", "torque_sensor", "moves"),
    reads_torque=True,
    confused_with=("wrist_coupling", "coupled_drive"),
    term=crosstalk_term,
    amplitudes=(Amplitude("c", "", _TYPICAL_SHARE, -20.0, 20.0),),
    shapes=(Shape("from_joint", "", _other_joints, 1.0, float(_MAX_JOINTS), fit="held"),),
    report=lambda a, s, constants: {"c": a[0], "from_joint": float(round(s[0]))},
    applies=lambda constants: constants.joints > 1,
    # Rare beside couplings of gears, which act between neighbours.
    log_prior=lambda constants: -2.0,
    remedy=_describe_remedy,
    separate="Move the other joint alone in both directions: its friction then jumps in this"
    " joint's torque, which no mass or gear of this joint does.",
)
