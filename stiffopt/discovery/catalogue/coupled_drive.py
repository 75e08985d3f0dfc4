"""Wrist drive whose motor turns with two joints: its friction and rotor load both of them.

In many wrists the motor of one joint sits behind the previous joint, so that it turns by the sum of
both angles. A model with one rotor and friction per joint has neither.
"""

from __future__ import annotations

from stiffopt.discovery.catalogue.common import dry_friction, motor_inertia, viscous_friction
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointSignals, smooth_sign

# Smallest share of the previous joint in the motor's turning; gears of wrists have 1.
_MIN_SHARE = 0.5


def coupled_drive_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return Fc sg(w) + Fv w + J dw/dt of a motor, w = v_j + c v_before, on both joints."""
    share = shapes[0]
    speed = signals.motor_velocity + share * signals.previous_velocity
    rate = signals.motor_acceleration + share * signals.previous_acceleration
    dry, viscous, inertia = amplitudes
    torque = dry * smooth_sign(speed) + viscous * speed + inertia * rate
    return Term(drive_torque=torque, previous_torque=share * torque)


COUPLED_DRIVE = Effect(
    name="coupled_drive",
    family="friction",
    scope="joint",
    equation="tau_j += f, tau_before += c*f, f = Fc*sg(w) + Fv*w + J*dw/dt, w = v_j + c*v_before",
    signature="motor torques of a wrist joint and the one before off together, with the speed of"
    " their sum or difference",
    phrase="a drive that turns with the joint before too, {c} turns a turn",
    remedy="Check in the gear plan of the wrist whether {where} is coupled with the joint"
    " before, and enter its friction as that of the sum.",
    needs=("torque", "moves", "reverses", "before"),
    confused_with=("coulomb", "viscous", "rotor_inertia"),
    term=coupled_drive_term,
    amplitudes=(
        Amplitude("Fc", "N m", dry_friction, 0.0, 10.0),
        Amplitude("Fv", "N m s/rad", viscous_friction, 0.0, 10.0),
        Amplitude("J", "kg m^2", motor_inertia, 0.0, 10.0),
    ),
    shapes=(Shape("c", "", (1.0, -1.0), -1.5, 1.5),),
    report=lambda a, s, constants: {**dict(zip(("Fc", "Fv", "J"), a, strict=True)), "c": s[0]},
    applies=lambda constants: constants.joint > 4,
    # Otherwise it is an ordinary drive.
    possible=lambda shapes, constants: abs(shapes[0]) >= _MIN_SHARE,
    log_prior=lambda constants: -1.0,
    separate="Move both wrist joints together and against each other at one speed: the friction of"
    " their sum vanishes in one of the two.",
)
