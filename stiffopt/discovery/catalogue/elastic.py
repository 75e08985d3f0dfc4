"""Wind-up between motor angle and link angle that depends on the side or the way of the load.

Each follows the nominal spring torque, so it needs no measured torque. Presliding hysteresis after
Dahl (1968).
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from stiffopt.discovery.catalogue.common import winds_up
from stiffopt.discovery.catalogue.history import remember
from stiffopt.discovery.comparison.signals import JointConstants, JointSignals
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
from stiffopt.symbolic import Quantity


def backlash_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Half the width times s/sqrt(s^2 + e^2): the flank follows the side of the load."""
    s = signals.spring_torque
    rounding = shapes[0] * signals.constants.torque_rated
    return Term(deflection=0.5 * amplitudes[0] * s / np.sqrt(s * s + rounding * rounding))


def hysteresis_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Wind-up -D'(s) h y: inner friction h y carries part of the torque and lags the wind-up."""
    d = signals.windup
    side = remember(dahl, [d], [0.0, d[0]], [shapes[0]])
    slope = signals.constants.compliance(signals.spring_torque)
    return Term(deflection=-amplitudes[0] * slope * side)


def dahl(
    state: Quantity, inputs: Sequence[Quantity], parameters: Sequence[Quantity]
) -> tuple[Quantity, Quantity]:
    """Presliding friction over its limit: dy/dd = (1 - y sgn(dd))/range, exact in each step."""
    travel = inputs[0] - state[1]
    side = np.sign(travel)
    now = side + (state[0] - side) * np.exp(-np.abs(travel) / parameters[0])
    return ca.vertcat(now, inputs[0]), now


def _loop_height(constants: JointConstants) -> float:
    return 0.04 * constants.torque_rated


BACKLASH = Effect(
    name="backlash",
    family="elastic",
    scope="joint",
    equation="d += width/2*s/sqrt(s^2 + e^2)",
    signature="motor and link angle step apart where the load changes side, and nowhere else",
    needs=("link", "moves", "load_changes_sign"),
    confused_with=("k1_softening", "preload_loss"),
    reference="NordinGutman2002",
    term=backlash_term,
    amplitudes=(Amplitude(name="width", unit="rad", scale=3e-4, lower=0.0, upper=10.0),),
    shapes=(
        Shape(name="rounding", unit="", starts=(0.002, 0.008, 0.03), lower=0.0005, upper=0.08),
    ),
    report=lambda amplitudes, shapes, constants: {"width": amplitudes[0]},
    applies=winds_up,
    separate="Carry the load slowly through zero torque: backlash is a step between two plateaus,"
    " a soft joint bends gradually, an encoder offset does not change side.",
)

HYSTERESIS = Effect(
    name="hysteresis",
    family="elastic",
    scope="joint",
    equation="d += -D'(s)*h*y, dy/dd = (1 - y*sgn(dd))/s",
    signature="wind-up that takes another way under falling load than under rising load, whatever"
    " the speed",
    phrase="hysteresis of the wind-up",
    needs=("link", "moves", "reverses"),
    term=hysteresis_term,
    amplitudes=(Amplitude(name="h", unit="N m", scale=_loop_height, lower=0.0, upper=3.0),),
    shapes=(Shape(name="s", unit="rad", starts=(1e-4, 3e-4, 1e-3), lower=2e-5, upper=5e-3),),
    applies=winds_up,
    separate="Load and unload slowly, at two speeds and two amplitudes: creep shrinks when slow,"
    " hysteresis does not; backlash has one value for each load.",
)
