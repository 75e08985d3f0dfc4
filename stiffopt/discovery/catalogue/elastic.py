"""Wind-up that depends on the side or the history of the load: backlash and hysteresis.

Both need no measured torque. Hysteresis is that of contacts that slide one after the other (Iwan
1966): a loop closes where it began, as of all dry contacts. Their friction acts beside the spring:
it depends on the deflection itself, so that the load grows with it however steep the friction is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.catalogue.common import (
    carried_share,
    dry_friction,
    motor_inertia,
    shares_of_carried,
    viscous_friction,
    winds_up,
)
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointConstants, JointSignals, smooth_sign

# Sliders of a presliding friction: 2000 differ by 2 % of its largest value.
_SLIDER_COUNT = 10
# Smallest rounding of a flank over the rated torque.
_MIN_ROUNDING = 5e-5
# Backlash about which friction of a crossing motor is at least linearised [rad], and the typical
# one of a gear that a commanded joint shows.
_MIN_WIDTH, _TYPICAL_WIDTH = 1e-4, 5e-3


def backlash_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return half the width times s/sqrt(s^2 + e^2): the flank follows the side of the load."""
    s = signals.spring_torque
    rounding = shapes[0] * signals.constants.torque_rated
    return Term(deflection=0.5 * amplitudes[0] * s / np.sqrt(s * s + rounding * rounding))


def output_backlash_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the torque of a motor that crosses the backlash behind the encoder of the link.

    Its travel and rates follow from the side of the load; dry friction turns where the crossing is
    faster than the link, linear about the travel of the first shape. A motor that rattles within
    the backlash turns it all the time: on the mean a share of it is lost.
    """
    travel = backlash_term(signals, (1.0,), shapes[1:]).deflection
    speed = np.gradient(travel, signals.dt)
    own, link = signals.constants, signals.motor_velocity
    width = max(shapes[0], _MIN_WIDTH)
    turned = smooth_sign(link + width * speed) - smooth_sign(link)
    torque = motor_inertia(own) * np.gradient(speed, signals.dt) + viscous_friction(own) * speed
    crossing = torque + dry_friction(own) / width * turned
    lost = dry_friction(own) * signals.motor_direction
    return Term(drive_torque=amplitudes[0] * crossing - amplitudes[1] * lost)


def hysteresis_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return wind-up -D'(s) h y: inner friction h y carries part of the torque and lags.

    D' is the mean slope over the height of a usual loop: D(s - h y) - D(s) jumps at the corners of
    a reducer, and no link motion is consistent with a jump.
    """
    side, _ = _presliding_friction(signals, *shapes)
    return Term(deflection=-amplitudes[0] * _mean_compliance(signals) * side)


def hysteresis_slope(signals: JointSignals, amplitudes: Values, shapes: Values) -> np.ndarray:
    """Return how the added wind-up changes with that between motor and link (K,), negative."""
    _, slope = _presliding_friction(signals, *shapes)
    return np.asarray(-amplitudes[0] * _mean_compliance(signals) * slope)


def _mean_compliance(signals: JointSignals) -> np.ndarray:
    torque, height = signals.spring_torque, _loop_height(signals.constants)
    ends = [signals.constants.windup(torque + end) for end in (-height, height)]
    return np.asarray((ends[1] - ends[0]) / (2.0 * height))


def _presliding_friction(
    signals: JointSignals, reach: float, exponent: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return friction over its limit (K,), and its slope by the travel of motor against link.

    Sliders in parallel yield one after the other. All have the same stiffness; their limits are
    spread over the reach by a power: 0 for a single slider, 1 for an even spread, more for a steep
    rise and a long way to the limit.
    """
    windup = signals.motor_position - signals.link_position
    limits = reach * ((np.arange(_SLIDER_COUNT) + 0.5) / _SLIDER_COUNT) ** exponent
    travel = np.diff(windup, prepend=windup[:1])
    moving = np.flatnonzero(travel)
    turns = np.flatnonzero(np.diff(np.sign(travel[moving]))) + 1
    found, strain = np.zeros_like(windup), np.zeros(_SLIDER_COUNT)
    held = np.ones_like(windup)
    for stretch in np.split(moving, turns) if moving.size else ():
        # In one direction no slider takes back what it has slid.
        strains = np.clip(strain + np.cumsum(travel[stretch])[:, None], -limits, limits)
        found[stretch], strain = strains.mean(axis=1) / limits.mean(), strains[-1]
        held[stretch] = np.mean(np.abs(strains) < limits, axis=1)
    last = np.maximum.accumulate(np.where(travel != 0.0, np.arange(len(travel)), 0))
    return found[last], held[last] / limits.mean()


def _loop_height(constants: JointConstants) -> float:
    return 0.04 * constants.torque_rated


BACKLASH = Effect(
    name="backlash",
    family="elastic",
    scope="joint",
    equation="d += width/2*s/sqrt(s^2 + e^2)",
    signature="motor and link angle step apart where the load changes side, and nowhere else",
    phrase="backlash {width}",
    remedy="Check gear mesh, key and coupling of {where} for play, and adjust or replace the"
    " worn part.",
    needs=("windup", "moves", "load_changes_sign"),
    confused_with=("k1_softening", "preload_loss"),
    reference="NordinGutman2002",
    term=backlash_term,
    is_play=True,
    amplitudes=(Amplitude("width", "rad", 3e-4, 0.0, 10.0),),
    shapes=(
        Shape("rounding", "", shares_of_carried(0.002, 0.008, 0.03), 1e-7, 0.08, reported=False),
    ),
    possible=lambda shapes, constants: shapes[0] >= _MIN_ROUNDING * carried_share(constants),
    applies=winds_up,
    separate="Carry the load slowly through zero torque: backlash is a step between two plateaus,"
    " a soft joint bends gradually, an encoder offset does not change side.",
)

OUTPUT_BACKLASH = Effect(
    name="output_backlash",
    family="geometry",
    scope="joint",
    equation="tau += J*d2p/dt2 + Fv*dp/dt + Fc*(sg(v + dp/dt) - sg(v)),"
    " - lost*Fc*sg(v), p = width/2*s/sqrt(s^2 + e^2)",
    signature="torque in short bursts where the load of the joint changes side",
    title="backlash before the encoder",
    phrase="backlash {width} between the motor and the encoder at the output",
    remedy="Check gear mesh, key and coupling of {where} for play, and adjust or replace the"
    " worn part.",
    needs=("commanded", "moves", "load_changes_sign"),
    confused_with=("coulomb", "rotor_inertia", "stribeck"),
    reference="NordinGutman2002",
    term=output_backlash_term,
    at_motor=BACKLASH,
    loses="coulomb",
    amplitudes=(
        Amplitude("width", "rad", _TYPICAL_WIDTH, 0.0, 20.0, own=True),
        Amplitude("lost", "", 1.0, 0.0, 1.0),
    ),
    shapes=(
        Shape("about", "rad", (0.0,), 0.0, 20.0 * _TYPICAL_WIDTH, 0.0, fit="secant"),
        replace(BACKLASH.shapes[0], upper=0.5),
    ),
    report=lambda amplitudes, shapes, constants: {"width": amplitudes[0]},
    applies=lambda constants: not constants.elastic,
    # Bursts of torque are what any error of friction leaves at reversals.
    log_prior=lambda constants: -2.0,
    separate="Hold the joint where its load changes side and step the command: the motor runs"
    " through the backlash before the link moves.",
)

HYSTERESIS = Effect(
    name="hysteresis",
    family="elastic",
    scope="joint",
    equation="d += -D'(load)*h*y, y = sum_u stop(d, r_u)/sum_u r_u, r_u = s*u^i, u = 0.05 to 0.95",
    signature="wind-up that differs between falling and rising load at equal torque, whatever"
    " the speed",
    phrase="hysteresis of the wind-up, {h}",
    remedy="Look for sliding contacts at {where}: bolts, keys and splines; tighten them to"
    " their torque.",
    needs=("windup", "moves", "reverses"),
    reference="Iwan1966",
    term=hysteresis_term,
    deflection_slope=hysteresis_slope,
    amplitudes=(Amplitude("h", "N m", _loop_height, 0.0, 3.0),),
    shapes=(
        Shape("s", "rad", (1e-4, 3e-4, 1e-3), 2e-5, 5e-3),
        # Spread of the sliders: recordings seldom show it, but h depends on it.
        Shape("i", "", (1.0,), 0.0, 5.0, 1.0, reported=False),
    ),
    applies=winds_up,
    separate="Load and unload slowly, at two speeds and two amplitudes: creep shrinks when slow,"
    " hysteresis does not; backlash has one value for each load.",
)
