"""Friction beyond the nominal Coulomb and viscous terms: torques that oppose motion.

Sources of the forms: Armstrong-Helouvry, Dupont, Canudas de Wit (1994) for the dependence on speed;
Bittencourt and Axelsson (2014) for load and temperature.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.discovery.catalogue.common import (
    WEIGHT,
    along_stroke,
    carried_share,
    dry_friction,
    shares_of_carried,
    viscous_friction,
)
from stiffopt.discovery.catalogue.robot_change import add_to_nominal_value
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.settings import SIGN_SPEED
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.symbolic import Quantity, smooth_abs

# Rounding of the carried load over the rated torque, default and minimum.
_LOAD_ROUNDING_SHARE, _MIN_LOAD_ROUNDING = 0.02, 0.002
# Rounding of the magnitude of a speed over SIGN_SPEED.
_SPEED_ROUNDING_SHARE = 0.1
# Friction over part of the stroke: angle over which it sets in [rad].
_EDGE_WIDTH = 0.02
# Least and largest share of the stroke between the angles: less is a tight place, more is dry
# friction everywhere.
_MIN_SHARE, _MAX_SHARE = 0.1, 0.85
# Its angles that are tried, as shares of the stroke; those beyond it leave one edge.
_FIRST_SHARES, _LAST_SHARES = (-0.05, 0.25, 0.5, 0.75), (0.3, 0.6, 1.05)
# Initial widths of a tight place, and the least one, over their scale.
_WIDTH_SHARES, _MIN_WIDTH_SHARE = (0.12, 0.3, 0.7), 0.05


def rounded_speed(velocity: Quantity) -> Quantity:
    """Return the magnitude of a speed, rounded at zero so that its powers are differentiable."""
    return smooth_abs(velocity, _SPEED_ROUNDING_SHARE * SIGN_SPEED)


def rounded_load(signals: JointSignals, share: Quantity) -> Quantity:
    """Return the magnitude of the load, rounded within a share of the rated torque [N m]."""
    rounding = share * signals.constants.torque_rated
    return smooth_abs(signals.spring_torque, rounding) - rounding


def stribeck_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return A exp(-|w/vs|^n) sg(w); n = 2 after Gauss, n = 1 after Tustin."""
    w = signals.motor_velocity
    speed, power = shapes
    fall = np.exp(-((rounded_speed(w) / speed) ** power))
    return Term(drive_torque=amplitudes[0] * fall * signals.motor_direction)


def position_friction_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return friction A exp(-((q - q0)/width)^2 / 2) sg(w) at an angle."""
    place, width = shapes
    bump = np.exp(-0.5 * ((signals.link_position - place) / width) ** 2)
    return Term(drive_torque=amplitudes[0] * bump * signals.motor_direction)


def stroke_friction_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return dry friction A sg(w) between two angles, with rounded edges."""
    first, last = shapes
    q = signals.link_position
    inside = 0.5 * (np.tanh((q - first) / _EDGE_WIDTH) - np.tanh((q - last) / _EDGE_WIDTH))
    return Term(drive_torque=amplitudes[0] * inside * signals.motor_direction)


def thermal_friction_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the change by exp(-b (T - T0)) - 1 of viscous and a share of dry friction."""
    constants, w = signals.constants, signals.motor_velocity
    fall = np.exp(-shapes[0] * signals.temperature_rise) - 1.0
    viscous = viscous_friction(constants) * w
    dry = dry_friction(constants) * signals.motor_direction
    return Term(drive_torque=(amplitudes[0] * viscous + amplitudes[1] * dry) * fall)


def half_dry_friction(constants: JointConstants) -> float:
    """Return half the dry friction, the typical size of its change [N m]."""
    return 0.5 * dry_friction(constants)


def start_slow_speeds(constants: JointConstants) -> tuple[float, ...]:
    """Return initial speeds below which dry friction increases [rad/s]."""
    highest = min(0.5, max(0.5 * constants.fastest, 0.03))
    return tuple(float(v) for v in np.geomspace(0.02, highest, 5))


def _is_within_stroke(shapes: Values, constants: JointConstants) -> bool:
    """Return True for a tight place within the stroke and narrower than half of it."""
    low, high = constants.stroke
    place, width = shapes
    least = _MIN_WIDTH_SHARE * _width_scale(constants)
    return bool(low <= place <= high and least <= width <= 0.5 * (high - low))


def _width_scale(constants: JointConstants) -> float:
    """Return the scale of a tight place's width: 1 rad, or a shorter stroke, as of a slider [m]."""
    low, high = constants.stroke
    return min(high - low, 1.0)


def _start_angles(shares: Sequence[float], constants: JointConstants) -> tuple[float, ...]:
    low, high = constants.stroke
    return tuple(low + share * (high - low) for share in shares)


def _is_part_of_stroke(shapes: Values, constants: JointConstants) -> bool:
    low, high = constants.stroke
    first, last = (min(max(angle, low), high) for angle in shapes)
    return bool(_MIN_SHARE <= (last - first) / max(high - low, 1e-9) <= _MAX_SHARE)


def is_definite_load(share: float, constants: JointConstants) -> bool:
    """Return True where the rounding of a load is large enough for the joint."""
    return share >= _MIN_LOAD_ROUNDING * carried_share(constants)


# The rounding has no datasheet value and hardly shows; it affects mu.
LOAD_ROUNDING = Shape(
    "rounding",
    "",
    shares_of_carried(_LOAD_ROUNDING_SHARE),
    1e-7,
    0.1,
    _LOAD_ROUNDING_SHARE,
    reported=False,
)

COULOMB = Effect(
    name="coulomb",
    family="friction",
    scope="joint",
    equation="tau += dFc*sg(w)",
    signature="motor torque off by a constant whose sign follows the direction, at every speed,"
    " angle and load",
    title="Coulomb friction",
    nominal="coulomb",
    nominal_words="dry friction",
    phrase=("{dFc} more dry friction than the model", "{dFc} less dry friction than the model"),
    remedy="Enter Coulomb friction {new} for {where}, and look at what rubs or binds there:"
    " grease, seals, brake.",
    needs=("torque", "moves", "reverses"),
    confused_with=("stribeck", "hysteresis", "position_friction"),
    reference="ArmstrongEtAl1994",
    change_robot=add_to_nominal_value,
    term=lambda signals, a, s: Term(drive_torque=a[0] * signals.motor_direction),
    amplitudes=(Amplitude("dFc", "N m", half_dry_friction, -2.0, 10.0),),
    separate="Move at three speeds or more, in both directions: Coulomb friction does not change"
    " with speed.",
)

VISCOUS = Effect(
    name="viscous",
    family="friction",
    scope="joint",
    equation="tau += dFv*w",
    signature="motor torque off in proportion to speed, alike in both directions",
    title="viscous friction",
    nominal="viscous",
    nominal_words="viscous friction",
    phrase=(
        "{dFv} more viscous friction than the model",
        "{dFv} less viscous friction than the model",
    ),
    remedy="Enter viscous friction {new} for {where}, and look at the lubricant and its"
    " temperature there.",
    needs=("torque", "moves", "speeds"),
    confused_with=("thermal_friction", "time_delay"),
    reference="ArmstrongEtAl1994",
    change_robot=add_to_nominal_value,
    term=lambda signals, a, s: Term(drive_torque=a[0] * signals.motor_velocity),
    amplitudes=(Amplitude("dFv", "N m s/rad", viscous_friction, -1.0, 5.0),),
    separate="Hold constant speeds up to the fastest, once cold and once warm: a delay shows only"
    " while the torque changes, heat only from run to run.",
)

STRIBECK = Effect(
    name="stribeck",
    family="friction",
    scope="joint",
    equation="tau += A*exp(-abs(w/vs)^n)*sg(w)",
    signature="motor torque too high only at low speed, against the motion",
    title="Stribeck friction",
    phrase="{A} more friction at low speed, below {vs}",
    remedy="Warm {where} up and check its lubricant; in the model, add the low-speed"
    " friction of extended.toml.",
    needs=("torque", "moves", "reverses", "slow"),
    confused_with=("hysteresis",),
    reference="ArmstrongEtAl1994",
    term=stribeck_term,
    amplitudes=(Amplitude("A", "N m", half_dry_friction, 0.0, 10.0),),
    shapes=(
        Shape("vs", "rad/s", start_slow_speeds, 0.005, 0.5),
        Shape("n", "", (1.0, 2.0), 0.5, 2.5, reported=False),
    ),
    separate="Ramp slowly through 0.01 to 0.3 rad/s without reversing: hysteresis depends on the"
    " travel since the last reversal, not on speed.",
)

LOAD_FRICTION = Effect(
    name="load_friction",
    family="friction",
    scope="joint",
    equation="tau += mu*abs(s)*sg(w)",
    signature="motor torque off against the motion, in proportion to the size of the load"
    " carried, whatever its sign",
    phrase="friction that grows by {mu:%} of the load",
    remedy="Look at the gear mesh and bearings of {where}; in the model add load friction"
    " with mu = {mu}.",
    needs=("torque", "moves", "reverses"),
    reference="BittencourtAxelsson2014",
    term=lambda signals, a, s: Term(
        drive_torque=a[0] * rounded_load(signals, s[0]) * signals.motor_direction
    ),
    amplitudes=(Amplitude("mu", "", 0.1, 0.0, 6.0),),
    shapes=(LOAD_ROUNDING,),
    possible=lambda shapes, constants: is_definite_load(shapes[0], constants),
    separate="Repeat one path with two payloads, in both directions: a gain error keeps its sign"
    " when the motion turns round.",
)

ASYM_FRICTION = Effect(
    name="asym_friction",
    family="friction",
    scope="joint",
    equation="tau += sg(w)^2*dFc + abs(w)*dFv",
    signature="motor torque off alike in both directions while moving and not at rest, growing"
    " with the size of the speed",
    title="asymmetric friction",
    phrase="friction that differs by direction, by {dFc} and {dFv}",
    remedy="Check {where} for a spring, hose or brake that acts in one direction, then"
    " record it in both directions.",
    needs=("torque", "moves", "reverses"),
    confused_with=("torque_offset",),
    reference="ArmstrongEtAl1994",
    term=lambda signals, a, s: Term(
        drive_torque=a[0] * signals.motor_direction * signals.motor_direction
        + a[1] * signals.motor_velocity * signals.motor_direction
    ),
    amplitudes=(
        Amplitude("dFc", "N m", half_dry_friction, -2.0, 2.0),
        Amplitude("dFv", "N m s/rad", viscous_friction, -1.0, 1.0),
    ),
    separate="Stop for a second in several postures: a torque offset and a gravity error act at"
    " rest too, friction between the directions does not.",
)

POSITION_FRICTION = Effect(
    name="position_friction",
    family="friction",
    scope="joint",
    equation="tau += A*exp(-((q - q0)/width)^2/2)*sg(w)",
    signature="motor torque too high against the motion at one place of the stroke, in both"
    " directions",
    phrase="a tight place in the stroke, {A} at {q0}",
    remedy="Turn {where} by hand through {q0}, and look at gear, bearing and hoses at that place.",
    needs=("torque", "moves", "reverses"),
    reference="ArmstrongEtAl1994",
    term=position_friction_term,
    amplitudes=(Amplitude("A", "N m", dry_friction, 0.0, 3.0),),
    shapes=(
        Shape("q0", "rad", lambda constants: along_stroke(constants, 10), -20.0, 20.0),
        Shape(
            "width",
            "rad",
            lambda constants: tuple(v * _width_scale(constants) for v in _WIDTH_SHARES),
            1e-4,
            1.5,
        ),
    ),
    possible=_is_within_stroke,
    separate="Sweep the whole stroke slowly both ways: a gravity error keeps its sign, friction"
    " turns with the direction.",
)

THERMAL_FRICTION = Effect(
    name="thermal_friction",
    family="friction",
    scope="joint",
    equation="tau += (exp(-b*(T - T0)) - 1)*(Fv*w + share*Fc*sg(w))",
    signature="motor torque against the motion that falls from run to run as the housing warms",
    phrase="friction that falls with temperature, {b}",
    remedy="Warm the robot up before work that needs accuracy, or plan {where} with friction"
    " for its housing temperature.",
    needs=("torque", "moves", "warmer"),
    confused_with=("time_delay",),
    reference="BittencourtAxelsson2014",
    term=thermal_friction_term,
    amplitudes=(WEIGHT, Amplitude("share", "", 0.3, 0.0, 3.3)),
    shapes=(Shape("b", "1/K", (0.01, 0.03, 0.06), 1e-4, 0.1),),
    # The share lost a kelvin at T0, also where the weight is not 1.
    report=lambda amplitudes, shapes, constants: {"b": amplitudes[0] * shapes[0]},
    separate="Repeat one motion cold and after half an hour of work: viscous friction alone stays"
    " the same.",
)

STROKE_FRICTION = Effect(
    name="stroke_friction",
    family="friction",
    scope="joint",
    equation="tau += A*sg(w) where q0 < q < q1",
    signature="motor torque too high against the motion over one part of the stroke, alike"
    " everywhere in it",
    title="friction over part of the stroke",
    phrase=(
        "{A} more dry friction over part of the stroke, from {q0} to {q1}",
        "{A} less dry friction over part of the stroke, from {q0} to {q1}",
    ),
    remedy="Look for a cable, seal or guard that rubs at {where}, between {q0} and {q1}.",
    needs=("torque", "moves", "reverses"),
    confused_with=("position_friction", "coulomb"),
    term=stroke_friction_term,
    amplitudes=(Amplitude("A", "N m", dry_friction, -1.0, 3.0),),
    shapes=(
        Shape("q0", "rad", lambda constants: _start_angles(_FIRST_SHARES, constants), -20.0, 20.0),
        Shape("q1", "rad", lambda constants: _start_angles(_LAST_SHARES, constants), -20.0, 20.0),
    ),
    possible=_is_part_of_stroke,
    separate="Sweep the whole stroke at one slow speed, both ways: the torque steps at the edges of"
    " the part, and nowhere else.",
)

QUADRATIC_DRAG = Effect(
    name="quadratic_drag",
    family="friction",
    scope="joint",
    equation="tau += D*w*abs(w)",
    signature="motor torque off against the motion by an amount that grows with the square of the"
    " speed",
    title="drag with the square of speed",
    phrase=(
        "drag of {D} times the square of speed",
        "friction that falls below proportion by {D} times the square of speed",
    ),
    remedy="Check the level and grade of the oil of {where}.",
    needs=("torque", "moves", "speeds"),
    confused_with=("viscous", "lubricated_friction"),
    reference="BittencourtAxelsson2014",
    term=lambda signals, a, s: Term(
        drive_torque=a[0] * signals.motor_velocity * rounded_speed(signals.motor_velocity)
    ),
    amplitudes=(
        Amplitude(
            "D",
            "N m s^2/rad^2",
            # Half the viscous friction at the fastest speed.
            lambda constants: 0.5 * viscous_friction(constants) / max(constants.fastest, 1e-3),
            -1.5,
            10.0,
        ),
    ),
    separate="Hold at least four constant speeds up to the fastest, both ways: torque over speed is"
    " a straight line for viscous friction, a parabola for drag.",
)

FRICTION = (
    COULOMB,
    VISCOUS,
    STRIBECK,
    LOAD_FRICTION,
    ASYM_FRICTION,
    POSITION_FRICTION,
    THERMAL_FRICTION,
)


# ---- a lubricated joint: load, speed and temperature together

# Exponent of the speed, as measured by Bittencourt and Axelsson.
_SPEED_EXPONENT = 1.3
# Temperature range over which the low-speed part typically doubles [K].
_TEMPERATURE_RANGE = 20.0


def lubricated_friction_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return load friction, increased where the film is thin, and falling viscous friction.

    Bittencourt and Axelsson (2014) measured interactions that the separate laws lack: load friction
    increases at low speed, where the film is thin, and a warm film is thin up to higher speeds.
    Their law, as a change from dry and viscous friction at the temperature of their identification,
    with the speed below which the film is thin growing as viscosity falls (one exponent for both)
    in place of a linear dependence.
    """
    of_load, of_load_slow, slow, slow_by_kelvin, weight = amplitudes
    speed, exponent, rounding = shapes
    w, rise = signals.motor_velocity, signals.temperature_rise
    viscosity = np.exp(-exponent * rise)
    thin = np.exp(-((rounded_speed(w) * viscosity / speed) ** _SPEED_EXPONENT))
    load = rounded_load(signals, rounding)
    level = of_load * load + (of_load_slow * load + slow + slow_by_kelvin * rise) * thin
    viscous = viscous_friction(signals.constants) * (viscosity - 1.0)
    return Term(drive_torque=level * signals.motor_direction + weight * viscous * w)


LUBRICATED_FRICTION = Effect(
    name="lubricated_friction",
    family="friction",
    scope="joint",
    equation="tau += (mu*abs(s) + (mu_slow*abs(s) + A + A_T*(T - T0))*thin)*sg(w)"
    " + (eta - 1)*Fv*w, eta = exp(-b*(T - T0)), thin = exp(-abs(eta*w/vs)^1.3)",
    signature="motor torque off against the motion by a share of the load that is larger at low"
    " speed, or at low speed by more as the housing warms",
    phrase="friction that depends on load, speed and temperature together, {mu} of the load",
    remedy="Check oil and grease of {where}; in the model, add the friction of extended.toml.",
    needs=("torque", "moves", "reverses", "slow"),
    confused_with=("load_friction", "stribeck", "thermal_friction"),
    reference="BittencourtAxelsson2014",
    term=lubricated_friction_term,
    amplitudes=(
        Amplitude("mu", "", 0.1, 0.0, 6.0),
        Amplitude("mu_slow", "", 0.1, 0.0, 6.0, own=True),
        Amplitude("A", "N m", half_dry_friction, 0.0, 4.0),
        Amplitude(
            "A_T",
            "N m/K",
            lambda constants: 0.5 * dry_friction(constants) / _TEMPERATURE_RANGE,
            0.0,
            4.0,
            own=True,
        ),
        WEIGHT,
    ),
    shapes=(
        Shape("vs", "rad/s", start_slow_speeds, 0.005, 0.5),
        Shape("b", "1/K", (0.03,), 1e-4, 0.1),
        LOAD_ROUNDING,
    ),
    report=lambda amplitudes, shapes, constants: {
        "mu": amplitudes[0],
        "mu_slow": amplitudes[1],
        "A": amplitudes[2],
        "A_T": amplitudes[3],
        "vs": shapes[0],
        "b": amplitudes[4] * shapes[1],
    },
    possible=lambda shapes, constants: is_definite_load(shapes[2], constants),
    separate="Move at five speeds down to 0.02 rad/s, with two payloads, cold and after half an"
    " hour of work: a load that rubs more when slow, and slow friction that grows with warmth, are"
    " of the film.",
)
