"""Errors of sensors and drives: gain, offset and saturation of readings.

Readings: torque reading = (1 + eps) drive torque + off, within its range;
link reading = link angle + off.
"""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import CHANGED_SCALE_RATIO
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointConstants, JointSignals, RobotSignals
from stiffopt.symbolic import Quantity

# Initial values: limits over the largest torque asked for, and sharpness of soft and hard limits.
_LIMIT_SHARES, _SOFT_KNEE, _HARD_KNEE = (0.15, 0.3, 0.5, 0.7, 0.85, 0.95), 14.0, 60.0
# Smallest limit of a reading over the largest filtered one: a filter overshoots.
_MIN_LIMIT_RATIO = 0.97


def encoder_offset_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return a constant added to the reading of the link angle."""
    return Term(reading=-amplitudes[0] + 0.0 * signals.windup)


def saturation_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the demanded torque beyond a drive's limit, which the drive does not give.

    A motion needs the torque that is given, and tells nothing of the demand beyond it: that is
    taken as recorded, or as an actuator's law asks for it.
    """
    asked = signals.drive_torque if signals.asked_torque is None else signals.asked_torque
    limit = shapes[0] * signals.constants.torque_max
    return Term(drive_torque=amplitudes[0] * _beyond(asked, limit, shapes[1]))


def reading_limit_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the torque that lies beyond the range of its reading, negative."""
    limit = shapes[0] * signals.constants.torque_max
    return Term(drive_torque=-amplitudes[0] * _beyond(signals.drive_torque, limit, _HARD_KNEE))


def _beyond(torque: Quantity, limit: float, sharpness: float) -> Quantity:
    """Return the part of a torque beyond a limit, to which the rest bends.

    Rapp's model of a saturating amplifier: x / (1 + |x / limit|^k)^(1/k).
    """
    above = np.fmax(np.abs(torque / limit), 1.0)  # its power would overflow
    power = above**-sharpness + np.abs(torque / limit / above) ** sharpness
    return torque * (1.0 - 1.0 / (above * power ** (1.0 / sharpness)))


def _largest_reading(constants: JointConstants) -> float:
    """Return the largest torque read over the highest torque."""
    return constants.measured_torque / constants.torque_max


def _start_limits(constants: JointConstants) -> tuple[float, ...]:
    return tuple(share * _largest_reading(constants) for share in _LIMIT_SHARES)


def _divide_readings(amplitudes: Values, shapes: Values, constants: JointConstants) -> str:
    return (
        "Check torque constant and unit of {where}, and divide its readings by"
        f" {1.0 + float(amplitudes[0]):.3g}."
    )


_READING_ZERO = Amplitude("off", "rad", 1e-3, -10.0, 10.0)

TORQUE_GAIN = Effect(
    name="torque_gain",
    family="sensor",
    scope="joint",
    equation="tau += eps*tau",
    signature="motor torque off in proportion to itself, whatever it comes from",
    phrase=("torque reading {eps:%} too large", "torque reading {eps:%} too small"),
    remedy=_divide_readings,
    tolerances=("torque_constant",),
    needs=("torque", "stated_gain", "moves"),
    # Of the predicted torque: the measured one would explain itself.
    term=lambda signals, a, s: Term(drive_torque=a[0] * signals.drive_torque),
    amplitudes=(Amplitude("eps", "", 0.1, -6.0, 6.0),),
    separate="Fasten a known mass and move fast and slowly: a wrong mass leaves friction and rotor"
    " inertia as they are, a gain scales everything.",
)

TORQUE_OFFSET = Effect(
    name="torque_offset",
    family="sensor",
    scope="joint",
    usual=True,
    equation="tau += off",
    signature="motor torque off by a constant, also at rest and in every posture",
    phrase="torque reading off by {off}",
    remedy="Zero the torque reading of {where}, or subtract {off}.",
    needs=("torque", "moves", "reverses"),
    term=lambda signals, a, s: Term(drive_torque=a[0] + 0.0 * signals.drive_torque),
    amplitudes=(
        Amplitude(
            "off",
            "N m",
            # Up to nearly half of the rated torque.
            lambda constants: 0.03 * constants.torque_rated,
            -15.0,
            15.0,
            CHANGED_SCALE_RATIO,
        ),
    ),
    separate="Stop for a second in several postures and move in both directions: friction that"
    " differs between directions vanishes at rest, weight changes with posture.",
)

ENCODER_OFFSET = Effect(
    name="encoder_offset",
    family="sensor",
    scope="joint",
    usual=True,
    equation="d += -off",
    signature="motor and link angle apart by a constant in every run",
    phrase="link encoder off by {off}",
    remedy="Reference the link encoder of {where} again, or subtract {off}.",
    needs=("link", "moves"),
    confused_with=("encoder_zero_change",),
    term=encoder_offset_term,
    amplitudes=(_READING_ZERO,),
    separate="Load the joint on both sides: an offset stays, backlash and wind-up change side.",
)

ENCODER_ZERO_CHANGE = Effect(
    name="encoder_zero_change",
    family="sensor",
    scope="run",
    equation="d += -off in one run",
    signature="motor and link angle apart by a constant that one run alone has",
    phrase="encoder zero moved by {off} in this run",
    remedy="Reference the link encoder again, and check its mounting; leave the run out"
    " until then.",
    needs=("link", "runs"),
    term=encoder_offset_term,
    amplitudes=(_READING_ZERO,),
    separate="Repeat one motion after referencing the encoders again: the offset of the run goes"
    " away.",
)

ENCODER_SKEW = Effect(
    name="encoder_skew",
    family="sensor",
    scope="robot",
    equation="d += d_skew*v",
    signature="motor and link angles of all joints apart in proportion to speed, with one factor",
    phrase="link encoders read {d} late",
    remedy="Shift the link encoders by {d}, or use one clock for all signals.",
    needs=("link", "moves"),
    term=lambda signals, a, s: Term(reading=a[0] * signals.link_velocity),
    amplitudes=(Amplitude("d", "s", 1e-3, -20.0, 20.0),),
    separate="Hold constant speeds in both directions under unlike loads: compliance follows the"
    " load, a skew follows the speed.",
)

SATURATION = Effect(
    name="saturation",
    family="sensor",
    scope="joint",
    equation="given = clip(tau, -limit, limit)",
    signature="motor torque that leaves the model only near one level, to which the true torque is"
    " limited",
    phrase="a drive that saturates, at {limit}",
    remedy="Keep the torque of {where} below {limit}: slower motion or less payload; check"
    " the drive's current limit.",
    needs=("torque", "moves"),
    limits_drive=True,
    takes_recorded=True,
    applies=lambda constants: constants.measured_torque > 0.0,
    term=saturation_term,
    amplitudes=(Amplitude("missing", "", 1.0, 0.0, 1.5),),
    shapes=(
        Shape("share", "", _start_limits, 0.01, 2.0),
        Shape("knee", "", (_SOFT_KNEE, _HARD_KNEE), 4.0, 200.0, reported=False),
    ),
    report=lambda a, s, constants: {"limit": s[0] * constants.torque_max},
    units={"limit": "N m"},
    separate="Ask for the highest torque several times: below the limit nothing is missing, a gain"
    " error shows at every torque.",
)

READING_LIMIT = Effect(
    name="reading_limit",
    family="sensor",
    scope="joint",
    equation="tau = clip(tau, -limit, limit)",
    signature="motor torque that stays at one level where the model needs more",
    phrase="a torque reading that ends at {limit}",
    remedy="Extend the range of the torque reading of {where} beyond {limit}, or leave its samples"
    " at that level out.",
    needs=("torque", "torque_sensor", "moves"),
    confused_with=("saturation",),
    term=reading_limit_term,
    amplitudes=(Amplitude("missing", "", 1.0, 0.0, 1.5),),
    shapes=(Shape("share", "", lambda constants: (_largest_reading(constants),), 0.01, 2.0),),
    possible=lambda shapes, constants: bool(
        shapes[0] >= _MIN_LIMIT_RATIO * _largest_reading(constants)
    ),
    applies=lambda constants: constants.measured_torque > 0.0,
    report=lambda a, s, constants: {"limit": s[0] * constants.torque_max},
    units={"limit": "N m"},
    separate="Hold a load that needs more torque than that level: a reading that ends there does"
    " not move.",
)

SENSORS = (
    TORQUE_GAIN,
    TORQUE_OFFSET,
    ENCODER_OFFSET,
    SATURATION,
    READING_LIMIT,
    ENCODER_SKEW,
    ENCODER_ZERO_CHANGE,
)


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
    phrase="{c:%} of the torque of another joint in the reading",
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


# Typical and widest deadband [rad]: some counts of a servo's encoder, and some degrees; and one
# within which no error lies.
_TYPICAL_WIDTH, _LARGEST_WIDTH, _NO_WIDTH = 5e-3, 0.1, 1e-9


def deadband_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the torque of an actuator's law that its controller does not ask for.

    Torque grows from zero at the edge. A planned motion has no law and no position error.
    """
    if signals.position_error is None:
        return Term()
    width = max(shapes[0], _NO_WIDTH)
    share = np.clip(signals.position_error / width, -1.0, 1.0)
    return Term(drive_torque=amplitudes[0] * signals.constants.position_gain * share)


DEADBAND = Effect(
    name="deadband",
    family="sensor",
    scope="joint",
    equation="tau += k*clip(cmd - q, -width, width)",
    signature="torque by an actuator's law too large by a constant with the sign of the position"
    " error, also at rest",
    phrase="a controller that ignores position errors up to {width}",
    remedy="Set the deadband of the controller of {where} to zero, or lead its commands by"
    " {width}.",
    needs=("commanded", "moves"),
    confused_with=("coulomb",),
    term=deadband_term,
    amplitudes=(Amplitude("width", "rad", _TYPICAL_WIDTH, 0.0, _LARGEST_WIDTH / _TYPICAL_WIDTH),),
    shapes=(Shape("about", "rad", (0.0,), 0.0, _LARGEST_WIDTH, 0.0, "secant", reported=False),),
    # Every joint has dry friction, few controllers a deadband.
    log_prior=lambda constants: -2.0,
    separate="Step the command by one count at rest, and read the current: within a deadband none"
    " flows, against friction it does.",
)
