"""External loads, and couplings with the previous joint: by gears, or by a drive of both."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import (
    dry_friction,
    motor_inertia,
    symmetric_amplitude,
    viscous_friction,
)
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointSignals, RobotConstants, RobotSignals, smooth_sign
from stiffopt.symbolic import smooth_abs

# Height over which the contact force sets in [m].
_CONTACT_ROUNDING = 1e-4
# Share of the joint before about which the direction of friction is at least linearised.
_MIN_SHARE = 1e-4
# Typical error of a coupling's ratio, and largest one.
_TYPICAL_COUPLING, _MAX_COUPLING = 0.01, 0.2


def wrist_coupling_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the torques of a link that turns by c of the joint before besides its own motor.

    By virtual work the joint before carries the share c of what acts on the link: the torque of the
    bodies, and friction and rotor inertia where these turn with the link (`at_link` 1), not with
    the motor (0). Then they follow its motion too; dry friction is linear about a share.
    """
    share, about, at_link = amplitudes[0], shapes[0], shapes[1]
    own = signals.constants
    about = about if abs(about) > _MIN_SHARE else _MIN_SHARE
    speed = signals.motor_velocity
    reversed_dry = smooth_sign(speed + about * signals.previous_velocity) - smooth_sign(speed)
    with_link = (
        own.rotor_inertia * signals.previous_acceleration
        + own.viscous * signals.previous_velocity
        + own.coulomb / about * reversed_dry
    )
    # Of nominal values on both sides: damping of a servo, which acts by its reading, has no part.
    carried = own.rotor_inertia * signals.motor_acceleration + signals.nominal_friction
    return Term(
        deflection=-share * signals.previous_position,
        drive_torque=share * at_link * with_link,
        previous_torque=share * (signals.spring_torque + at_link * carried),
    )


def external_contact_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return -J^T n k max(z - tool height, 0) of a level surface under the tool."""
    depth = shapes[0] - signals.tool_position[..., 2]
    pressed = 0.5 * (depth + smooth_abs(depth, _CONTACT_ROUNDING))
    lever = signals.tool_jacobian[:, 2, :]
    return Term(link_torque=-amplitudes[0] * lever * pressed[:, None])


def _start_heights(constants: RobotConstants) -> tuple[float, ...]:
    low, high = constants.tool_range[:, 2]
    shares = (0.03, 0.08, 0.15, 0.25, 0.4, 0.6)
    return tuple(float(low + share * (high - low)) for share in shares)


WRIST_COUPLING = Effect(
    name="wrist_coupling",
    family="contact",
    scope="joint",
    equation="q_j += c*th_(j-1), tau_(j-1) += c*s_j",
    signature="link angle that moves with the joint before, which carries a share of the torque",
    phrase="coupling with the joint before, {c}",
    remedy="Check the coupling ratio of {where} in the controller's wrist parameters, and"
    " correct it by {c}.",
    needs=("sensor", "moves", "before"),
    term=wrist_coupling_term,
    amplitudes=(symmetric_amplitude("c", "", _TYPICAL_COUPLING, _MAX_COUPLING),),
    shapes=(
        Shape("about", "", (0.0,), -_MAX_COUPLING, _MAX_COUPLING, 0.0, "secant", reported=False),
        Shape("at_link", "", (0.0, 1.0), 0.0, 1.0, 0.0, "held", reported=False),
    ),
    applies=lambda constants: constants.joint > 1,
    log_prior=lambda constants: 0.0 if constants.joint > 4 else -1.0,
    separate="Move the joint before while this one stands: an error of its own gear or encoder"
    " does not follow.",
)

EXTERNAL_CONTACT = Effect(
    name="external_contact",
    family="contact",
    scope="robot",
    equation="s += -J^T*n*k*max(z - z_tool, 0)",
    signature="link torques of several joints off together, and only where the tool is low",
    phrase="contact with the surroundings below {z}",
    remedy="Look for what the tool touches below {z}, and record again without it.",
    needs=("torque", "moves", "tool_frame"),
    term=external_contact_term,
    amplitudes=(Amplitude("k", "N/m", 2e4, 0.0, 50.0),),
    shapes=(Shape("z", "m", _start_heights, -10.0, 10.0),),
    separate="Visit one place several times from above, and places beside it: a payload acts"
    " everywhere, a contact only below its height.",
)

CONTACTS = (WRIST_COUPLING, EXTERNAL_CONTACT)


# Smallest share of the previous joint in the motor's turning; gears of wrists have 1.
_MIN_DRIVE_SHARE = 0.5


def coupled_drive_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return Fc sg(w) + Fv w + J dw/dt of a motor, w = v_j + c v_before, on both joints.

    In many wrists the motor of one joint sits behind the previous joint, so that it turns by the
    sum of both angles. A model with one rotor and friction per joint has neither.
    """
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
    applies=lambda constants: constants.joint > 4,
    # Otherwise it is an ordinary drive.
    possible=lambda shapes, constants: abs(shapes[0]) >= _MIN_DRIVE_SHARE,
    log_prior=lambda constants: -1.0,
    separate="Move both wrist joints together and against each other at one speed: the friction of"
    " their sum vanishes in one of the two.",
)


_FORCE_COMPONENTS = tuple(
    Amplitude(
        name,
        "N",
        # 3 % of the weight of the arm.
        lambda constants: max(0.03 * 9.81 * float(np.sum(constants.masses)), 0.5),
        -40.0,
        40.0,
    )
    for name in ("fx", "fy", "fz")
)


def _describe_remedy(amplitudes: Values, shapes: Values, constants: RobotConstants) -> str:
    parts = ", ".join(f"{value:.1f}" for value in amplitudes)
    return (
        f"A force of ({parts}) N pulls at the tool in every run: look for a hose, a cable or a"
        " balancer there, and record without it if it is not part of the arm."
    )


TOOL_FORCE = Effect(
    name="tool_force",
    family="contact",
    scope="robot",
    equation="s += -J^T*f, f constant in the base",
    signature="torques of several joints off as under one force on the tool of constant direction",
    phrase="a constant force at the tool",
    needs=("torque", "moves", "tool_frame"),
    confused_with=("payload", "external_contact", "base_tilt"),
    term=lambda signals, a, s: Term(link_torque=-(signals.tool_levers[..., :3] @ np.asarray(a))),
    amplitudes=_FORCE_COMPONENTS,
    remedy=_describe_remedy,
    separate="Accelerate the tool in the direction of the force: a payload's torque grows with the"
    " acceleration, that of a pulling hose does not.",
)

TURNING_TOOL_FORCE = Effect(
    name="turning_tool_force",
    family="contact",
    scope="robot",
    equation="s += -J^T*R*f, f constant in the tool",
    signature="torques of several joints off as under one force on the tool that turns with it",
    phrase="a force that is fixed to the tool",
    needs=("torque", "moves", "tool_frame"),
    confused_with=("payload", "tool_force"),
    term=lambda signals, a, s: Term(link_torque=-(signals.tool_levers[..., 3:] @ np.asarray(a))),
    amplitudes=_FORCE_COMPONENTS,
    remedy=_describe_remedy,
    separate="Turn the wrist by half a turn at one place: the force of a spring in the tool turns"
    " with it, that of a hose and of a payload does not.",
)

TOOL_FORCES = (TOOL_FORCE, TURNING_TOOL_FORCE)
