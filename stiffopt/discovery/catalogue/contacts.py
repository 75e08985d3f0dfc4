"""External loads: coupling with the previous joint, and contact of the tool."""

from __future__ import annotations

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
    amplitudes=(
        Amplitude(
            "c",
            "",
            _TYPICAL_COUPLING,
            -_MAX_COUPLING / _TYPICAL_COUPLING,
            _MAX_COUPLING / _TYPICAL_COUPLING,
        ),
    ),
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
