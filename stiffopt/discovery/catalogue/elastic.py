"""Wind-up that depends on the side or the history of the load: backlash and hysteresis.

Both depend on the nominal spring torque and need no measured torque. Presliding hysteresis after
Dahl (1968), with his exponent.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from stiffopt.discovery.catalogue.common import carried_share, winds_up
from stiffopt.discovery.catalogue.recurrence import linear_recurrence, recurrence_output
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.symbolic import Quantity, is_symbolic

# Distance of the exponent from one within which a series is used; remainder to the limit that
# counts as reached.
_SERIES_RANGE, _MIN_REMAINDER = 1e-3, 1e-9
# Smallest rounding of a flank over the rated torque.
_MIN_ROUNDING = 5e-5


def backlash_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Return half the width times s/sqrt(s^2 + e^2): the flank follows the side of the load."""
    s = signals.spring_torque
    rounding = shapes[0] * signals.constants.torque_rated
    return Term(deflection=0.5 * amplitudes[0] * s / np.sqrt(s * s + rounding * rounding))


def hysteresis_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Return wind-up -D'(s) h y: inner friction h y carries part of the torque and lags.

    D' is the mean slope over the height of a usual loop: D(s - h y) - D(s) jumps at the corners of
    a reducer, and no link motion is consistent with a jump.
    """
    d = signals.windup
    if is_symbolic(d) or is_symbolic(shapes[0]) or shapes[1] != 1.0:
        side = recurrence_output(dahl, [d], [0.0, d[0]], [shapes[0], shapes[1]])
    else:
        side = _exponential_dahl(d, shapes[0])
    torque, height = signals.spring_torque, _loop_height(signals.constants)
    ends = [signals.constants.windup(torque + end) for end in (-height, height)]
    slope = (ends[1] - ends[0]) / (2.0 * height)
    return Term(deflection=-amplitudes[0] * slope * side)


def dahl(
    state: Quantity, inputs: Sequence[Quantity], parameters: Sequence[Quantity]
) -> tuple[Quantity, Quantity]:
    """Return presliding friction over its limit: dy/dd = (1 - y sgn(dd))^i/range.

    Exact per step.
    """
    reach, exponent = parameters[0], parameters[1]
    travel = inputs[0] - state[1]
    side = np.sign(travel)
    # The Box-Cox transform of the remainder decreases in proportion to the travel.
    left = ca.fmax(1.0 - state[0] * side, _MIN_REMAINDER)
    fallen = _box_cox(ca.log(left), 1.0 - exponent) - np.abs(travel) / reach
    left = ca.fmax(_inverse_box_cox(fallen, 1.0 - exponent), 0.0)
    now = ca.if_else(side == 0.0, state[0], side * (1.0 - left))
    return ca.vertcat(now, inputs[0]), now


def _exponential_dahl(windup: np.ndarray, reach: float) -> np.ndarray:
    """Return `dahl` for the exponent one: the remainder to the limit decays exponentially."""
    travel = np.diff(windup, prepend=windup[:1])
    kept = np.exp(-np.abs(travel) / reach)
    return linear_recurrence(kept, np.sign(travel) * (1.0 - kept))


def _box_cox(logarithm: Quantity, rest: Quantity) -> Quantity:
    """Return (x^rest - 1)/rest from the logarithm of x, log(x) at rest zero."""
    series = logarithm * (1.0 + rest * logarithm / 2.0 * (1.0 + rest * logarithm / 3.0))
    near = ca.fabs(rest) < _SERIES_RANGE
    divisor = ca.if_else(near, 1.0, rest)
    return ca.if_else(near, series, ca.expm1(divisor * logarithm) / divisor)


def _inverse_box_cox(power: Quantity, rest: Quantity) -> Quantity:
    """Return x with (x^rest - 1)/rest = `power`; zero where the limit is reached."""
    inside = rest * power
    series = power * (1.0 - inside / 2.0 * (1.0 - 2.0 * inside / 3.0))
    near = ca.fabs(rest) < _SERIES_RANGE
    divisor = ca.if_else(near, 1.0, rest)
    logarithm = ca.log1p(ca.fmax(inside, _MIN_REMAINDER - 1.0)) / divisor
    return ca.if_else(
        inside <= _MIN_REMAINDER - 1.0, 0.0, ca.exp(ca.if_else(near, series, logarithm))
    )


def _loop_height(constants: JointConstants) -> float:
    return 0.04 * constants.torque_rated


def _start_roundings(constants: JointConstants) -> tuple[float, ...]:
    return tuple(carried_share(constants) * share for share in (0.002, 0.008, 0.03))


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
    amplitudes=(Amplitude(name="width", unit="rad", scale=3e-4, lower=0.0, upper=10.0),),
    shapes=(Shape(name="rounding", unit="", starts=_start_roundings, lower=1e-7, upper=0.08),),
    report=lambda amplitudes, shapes, constants: {"width": amplitudes[0]},
    possible=lambda shapes, constants: shapes[0] >= _MIN_ROUNDING * carried_share(constants),
    applies=winds_up,
    separate="Carry the load slowly through zero torque: backlash is a step between two plateaus,"
    " a soft joint bends gradually, an encoder offset does not change side.",
)

HYSTERESIS = Effect(
    name="hysteresis",
    family="elastic",
    scope="joint",
    equation="d += -D'(s)*h*y, dy/dd = (1 - y*sgn(dd))^i/s",
    signature="wind-up that differs between falling and rising load at equal torque, whatever"
    " the speed",
    phrase="hysteresis of the wind-up, {h}",
    remedy="Look for sliding contacts at {where}: bolts, keys and splines; tighten them to"
    " their torque.",
    needs=("windup", "moves", "reverses"),
    term=hysteresis_term,
    amplitudes=(Amplitude(name="h", unit="N m", scale=_loop_height, lower=0.0, upper=3.0),),
    shapes=(
        Shape(name="s", unit="rad", starts=(1e-4, 3e-4, 1e-3), lower=2e-5, upper=5e-3),
        # Rate at which the loop approaches its limit: recordings seldom show it, but h depends on
        # it.
        Shape(name="i", unit="", starts=(1.0,), lower=0.3, upper=2.0, usual=1.0),
    ),
    report=lambda amplitudes, shapes, constants: {"h": amplitudes[0], "s": shapes[0]},
    units={"h": "N m", "s": "rad"},
    applies=winds_up,
    separate="Load and unload slowly, at two speeds and two amplitudes: creep shrinks when slow,"
    " hysteresis does not; backlash has one value for each load.",
)
