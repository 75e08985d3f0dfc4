"""Inertia errors: rotor inertia, payload, link masses."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import (
    CHANGED_SCALE_RATIO,
    Constants,
    motor_inertia,
    ratio_or_zero,
)
from stiffopt.discovery.catalogue.robot_change import add_to_body, add_to_nominal_value
from stiffopt.discovery.effect import (
    Amplitude,
    Effect,
    Reported,
    Term,
    Values,
)
from stiffopt.discovery.signals import (
    PARAMETERS_PER_BODY,
    RobotConstants,
    RobotSignals,
)
from stiffopt.symbolic import Quantity

# Typical error of a centre of mass [m].
_TYPICAL_DISTANCE = 0.1
# Distance of a mass added since a model was made over that of a modelling error.
_CHANGED_DISTANCE_RATIO = 3.0


def body_term(signals: RobotSignals, amplitudes: Values, body: int) -> Term:
    """Return the torques of changed inertial parameters of one body."""
    torque: Quantity = 0.0
    for k, amplitude in enumerate(amplitudes):
        # Columns are evaluated on demand: skip those of zero amplitude.
        if amplitude:
            torque = (
                torque + amplitude * signals.body_regressor[..., PARAMETERS_PER_BODY * body + k]
            )
    return Term(link_torque=torque)


def _report_payload(amplitudes: Values, shapes: Values, constants: Constants) -> Reported:
    mass, *moments = amplitudes[:4]
    places = (ratio_or_zero(moment, mass) for moment in moments)
    return {"dm": mass, **dict(zip(("cx", "cy", "cz"), places, strict=True))}


def _carried_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the torques of a part while it is carried."""
    if signals.carrying is None or not any(amplitudes):
        return Term()
    body = body_term(signals, amplitudes, signals.last_link)
    return Term(link_torque=body.link_torque * signals.carrying[:, None])


def _report_part(amplitudes: Values, shapes: Values, constants: Constants) -> Reported:
    payload = dict(_report_payload(amplitudes, shapes, constants))
    return {"m": payload.pop("dm"), **payload}


def _report_link(amplitudes: Values, shapes: Values, constants: Constants) -> Reported:
    mass, *moments = amplitudes[:4]
    xx, _, yy, _, _, zz = amplitudes[4:]
    return {
        "dm": mass,
        "dmc": float(np.linalg.norm(moments)),
        "dI": float(np.linalg.norm((xx, yy, zz))),
        **dict(zip(("dmcx", "dmcy", "dmcz"), moments, strict=True)),
    }


def _typical_mass(constants: RobotConstants) -> float:
    return max(0.03 * float(np.sum(constants.masses)), 0.05)


def _typical_moment(constants: RobotConstants) -> float:
    return _TYPICAL_DISTANCE * _typical_mass(constants)


def _moment_amplitudes(*names: str) -> tuple[Amplitude, ...]:
    return tuple(
        Amplitude(
            name,
            "kg m",
            _typical_moment,
            -40.0,
            40.0,
            CHANGED_SCALE_RATIO * _CHANGED_DISTANCE_RATIO,
        )
        for name in names
    )


# Inertia about the origin of the body's joint, in the order of the regressor.
_INERTIA_AMPLITUDES = tuple(
    Amplitude(
        name,
        "kg m^2",
        lambda constants: _TYPICAL_DISTANCE * _typical_moment(constants),
        -40.0,
        40.0,
        CHANGED_SCALE_RATIO * _CHANGED_DISTANCE_RATIO**2,
    )
    for name in ("dIxx", "dIxy", "dIyy", "dIxz", "dIyz", "dIzz")
)
_MASS_AMPLITUDE = Amplitude("dm", "kg", _typical_mass, -40.0, 40.0, CHANGED_SCALE_RATIO)

ROTOR_INERTIA = Effect(
    name="rotor_inertia",
    family="inertial",
    scope="joint",
    equation="tau += dJ*dw/dt",
    signature="motor torque off in proportion to the motor's own acceleration, alike in every"
    " posture",
    nominal="rotor_inertia",
    phrase=("{dJ} more rotor inertia than the model", "{dJ} less rotor inertia than the model"),
    remedy="Enter rotor inertia {new} for {where}, at the joint's output, and check the"
    " motor's data sheet.",
    needs=("torque", "moves"),
    change_robot=add_to_nominal_value,
    term=lambda signals, a, s: Term(drive_torque=a[0] * signals.motor_acceleration),
    amplitudes=(
        Amplitude(
            "dJ",
            "kg m^2",
            # The typical error of a stated value, or that of none: the whole one.
            lambda constants: (
                (0.25 if constants.rotor_inertia > 0.0 else 1.0) * motor_inertia(constants)
            ),
            -2.0,
            40.0,
            CHANGED_SCALE_RATIO,
        ),
    ),
    separate="Accelerate hard in several postures: the inertia of links changes with posture and"
    " winds the joint up, the rotor's does neither.",
)

PAYLOAD = Effect(
    name="payload",
    family="inertial",
    scope="robot",
    equation="s += Y_last(q, v, a)*(dm, dm*c, dI)",
    signature="link torques of several joints off together, as a mass at the last link makes them",
    phrase=(
        "{dm} heavier than the model, at {cx/cy/cz} of the last joint",
        "{dm} lighter than the model, at {cx/cy/cz} of the last joint",
    ),
    remedy="Change the payload by {dm} at {cx/cy/cz} of the last joint's frame, or weigh the"
    " tool and what it carries.",
    tolerances=("mass", "com"),
    needs=("torque", "moves"),
    confused_with=("torque_gain", "inertial_error", "base_tilt", "joint_zero", "encoder_offset"),
    shifts_weight=True,
    change_robot=lambda robot, found, joint, constants: add_to_body(robot, found, joint, "Payload"),
    term=lambda signals, a, s: body_term(signals, a, signals.last_link),
    amplitudes=(_MASS_AMPLITUDE, *_moment_amplitudes("mcx", "mcy", "mcz"), *_INERTIA_AMPLITUDES),
    report=_report_payload,
    units={"cx": "m", "cy": "m", "cz": "m"},
    separate="Turn the wrist by half a turn: a payload's torque turns with it, a cable's and a"
    " tilted base's does not.",
)

CARRIED_PART = Effect(
    name="carried_part",
    family="inertial",
    scope="robot",
    equation="s += Y_last(q, v, a)*(m, m*c, I) from grasp to release",
    signature="link torques of several joints off together for a while, as a mass at the last link"
    " makes them",
    phrase="a part of {m} carried for a while, at {cx/cy/cz} of the last joint",
    remedy="Enter the part of {m} as payload from grasp to release; record the gripper's state.",
    needs=("torque", "moves"),
    confused_with=("payload",),
    acts_for_a_while=True,
    term=_carried_term,
    amplitudes=PAYLOAD.amplitudes,
    report=_report_part,
    units={"m": "kg", **PAYLOAD.units},
    separate="Repeat the run with the gripper empty and with the part: the difference is the part.",
)

INERTIAL_ERROR = Effect(
    name="inertial_error",
    family="inertial",
    scope="link",
    equation="s += Y_link(q, v, a)*(dm, dmc, dI)",
    signature="torques of a link's own joint and of those before it off together, with gravity and"
    " acceleration",
    phrase="mass off by {dm}, first moment by {dmc}, inertia by {dI}",
    remedy="Check what is mounted on {where}: hoses, valves, covers; else change its mass by {dm}.",
    tolerances=("mass", "com"),
    needs=("torque", "moves"),
    confused_with=("torque_gain", "joint_zero"),
    shifts_weight=True,
    change_robot=lambda robot, found, joint, constants: add_to_body(robot, found, joint, "Masses"),
    term=lambda signals, a, s: body_term(signals, a, signals.link),
    amplitudes=(_MASS_AMPLITUDE, *_moment_amplitudes("dmcx", "dmcy", "dmcz"), *_INERTIA_AMPLITUDES),
    report=_report_link,
    units={"dmc": "kg m", "dI": "kg m^2"},
    separate="Move the joint of the link through its whole stroke, fast and slowly, in several"
    " postures of the others: friction turns with the direction, masses do not.",
)

INERTIAL = (ROTOR_INERTIA, PAYLOAD, CARRIED_PART, INERTIAL_ERROR)
