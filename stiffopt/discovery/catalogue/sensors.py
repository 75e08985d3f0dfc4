"""Errors of sensors and drives: gain, offset and saturation of readings.

Readings: torque reading = (1 + eps) drive torque + off; link reading = link angle + off.
"""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import CHANGED_SCALE_RATIO, dry_friction, viscous_friction
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointConstants, JointSignals, RobotSignals
from stiffopt.symbolic import softplus

# Rounding of a drive's torque limit over the highest torque.
_LIMIT_ROUNDING = 0.01
# Smallest torque limit over the largest filtered torque: a filter overshoots.
_MIN_LIMIT_RATIO = 0.97


def encoder_offset_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return a constant added to the reading of the link angle."""
    return Term(reading=-amplitudes[0] + 0.0 * signals.windup)


def saturation_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the demanded torque beyond a drive's limit, or the part clipped in a reading.

    Torque by an actuator's law is what it asks for: what lies beyond the limit is not given.
    Recorded motions need only the torque that the drive gives, so a demanded torque leaves the
    predicted one steeply near the limit.
    """
    highest = signals.constants.torque_max
    rounding = _LIMIT_ROUNDING * highest
    limit, asked = shapes[0] * highest, signals.drive_torque
    if signals.asked_torque is not None:
        asked = signals.asked_torque
    beyond = softplus((asked - limit) / rounding) - softplus((-asked - limit) / rounding)
    return Term(drive_torque=amplitudes[0] * rounding * beyond)


def _start_limits(constants: JointConstants) -> tuple[float, ...]:
    friction = dry_friction(constants) + viscous_friction(constants) * constants.fastest
    asked = min(1.0, (constants.largest_torque + friction) / constants.torque_max)
    return tuple(max(0.1, share * asked) for share in (0.4, 0.55, 0.7, 0.85, 0.97))


_READING_ZERO = Amplitude("off", "rad", 1e-3, -10.0, 10.0)

TORQUE_GAIN = Effect(
    name="torque_gain",
    family="sensor",
    scope="joint",
    equation="tau += eps*tau",
    signature="motor torque off in proportion to itself, whatever it comes from",
    phrase=("torque reading {eps:%} too large", "torque reading {eps:%} too small"),
    remedy="Check torque constant and unit of {where}, and correct its readings by {eps:%}.",
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
    term=saturation_term,
    # -1 is a clipped reading; a saturated drive demands many times the torque beyond the limit.
    amplitudes=(Amplitude("steepness", "", 10.0, -0.15, 20.0),),
    shapes=(Shape("share", "", _start_limits, 0.05, 1.2),),
    report=lambda a, s, constants: {"limit": s[0] * constants.torque_max},
    units={"limit": "N m"},
    possible=lambda shapes, constants: bool(
        shapes[0] * constants.torque_max >= _MIN_LIMIT_RATIO * constants.measured_torque
    ),
    separate="Ask for the highest torque several times: below the limit nothing is missing, a gain"
    " error shows at every torque.",
)

SENSORS = (
    TORQUE_GAIN,
    TORQUE_OFFSET,
    ENCODER_OFFSET,
    SATURATION,
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
