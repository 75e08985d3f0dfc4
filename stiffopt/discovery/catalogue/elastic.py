"""Wind-up that the nominal elastic joint lacks: what lies between motor angle and link angle.

Each follows the nominal spring torque, so it needs no measured torque. Sources of the forms:
Dahl (1968) for presliding hysteresis; the standard linear solid for belts; contact stiffness that
grows with a power of pressure for loosened connections.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from stiffopt.discovery.catalogue.common import (
    WEIGHT,
    Constants,
    contact_compliance,
    remember,
    winds_up,
    working_compliance,
)
from stiffopt.discovery.comparison.signals import JointConstants, JointSignals
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
from stiffopt.exact.reducer import reducer_windup
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


def stiffness_linear_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Wind-up x D(s)."""
    return Term(deflection=amplitudes[0] * signals.windup)


def k1_softening_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Wind-up of a reducer with another first slope and corner, less the nominal one."""
    constants, s = signals.constants, signals.spring_torque
    if constants.slopes is None or constants.torques is None:
        return Term(deflection=0.0 * s)
    (k1, k2, k3), (t1, t2) = constants.slopes, constants.torques
    k1_factor, t1_factor = shapes
    first = t1 * t1_factor
    # The second corner moves on only when the first passes it.
    worn = reducer_windup(s, (k1 * k1_factor, k2, k3), (first, np.fmax(t2, first)))
    added = worn - reducer_windup(s, constants.slopes, constants.torques)
    return Term(deflection=amplitudes[0] * added)


def preload_loss_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Wind-up c ((|s| + tp)^b - tp^b) sgn(s) of contacts that load presses together."""
    constants, s = signals.constants, signals.spring_torque
    rated = constants.torque_rated
    left, power = shapes
    pressed = (np.abs(s) / rated + left) ** power - left**power
    size = rated * contact_compliance(constants)
    return Term(deflection=amplitudes[0] * size * np.sign(s) * pressed)


def belt_creep_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Wind-up C_now s + C_creep y, dy/dt = (s - y)/tau_r."""
    s = signals.spring_torque
    # A belt has settled under the load that the run begins with.
    slow = remember(creep, [s], [s[0]], [np.exp(-signals.dt / shapes[0])])
    return Term(deflection=amplitudes[0] * s + amplitudes[1] * slow)


def creep(
    state: Quantity, inputs: Sequence[Quantity], parameters: Sequence[Quantity]
) -> tuple[Quantity, Quantity]:
    """First-order lag whose step keeps the share `parameters[0]` of the distance."""
    now = inputs[0] + (state[0] - inputs[0]) * parameters[0]
    return now, now


def _factor(
    amplitudes: Sequence[float], shapes: Sequence[float], constants: Constants
) -> Mapping[str, float]:
    return {"factor": 1.0 / (1.0 + amplitudes[0])}


def _corners(
    amplitudes: Sequence[float], shapes: Sequence[float], constants: Constants
) -> Mapping[str, float]:
    # The slope at zero torque holds exactly, also where the weight is not 1.
    softer = 1.0 + amplitudes[0] * (1.0 / shapes[0] - 1.0)
    return {"k1_factor": 1.0 / softer, "t1_factor": shapes[1]}


def _preload_left(
    amplitudes: Sequence[float], shapes: Sequence[float], constants: Constants
) -> Mapping[str, float]:
    return {"tp": shapes[0] * constants.torque_rated}


def _belt(
    amplitudes: Sequence[float], shapes: Sequence[float], constants: Constants
) -> Mapping[str, float]:
    return {"C": amplitudes[0] + amplitudes[1], "tau_r": shapes[0]}


def _may_have_belt(constants: JointConstants) -> bool:
    return winds_up(constants) and constants.belt is not False


def _loop_height(constants: JointConstants) -> float:
    return 0.04 * constants.torque_rated


def _has_corners(constants: JointConstants) -> bool:
    slopes = constants.slopes
    return slopes is not None and constants.torques is not None and slopes[0] != slopes[2]


BACKLASH = Effect(
    name="backlash",
    family="elastic",
    scope="joint",
    equation="d += width/2*s/sqrt(s^2 + e^2)",
    signature="motor and link angle step apart where the load changes side, and nowhere else",
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
    term=hysteresis_term,
    amplitudes=(Amplitude(name="h", unit="N m", scale=_loop_height, lower=0.0, upper=3.0),),
    shapes=(Shape(name="s", unit="rad", starts=(1e-4, 3e-4, 1e-3), lower=2e-5, upper=5e-3),),
    applies=winds_up,
    separate="Load and unload slowly, at two speeds and two amplitudes: creep shrinks when slow,"
    " hysteresis does not; backlash has one value for each load.",
)

STIFFNESS_LINEAR = Effect(
    name="stiffness_linear",
    family="elastic",
    scope="joint",
    equation="d += (1/factor - 1)*D(s)",
    signature="wind-up off in proportion to the nominal one",
    term=stiffness_linear_term,
    amplitudes=(Amplitude(name="x", unit="", scale=0.3, lower=-2.2, upper=7.8),),
    report=_factor,
    units={"factor": ""},
    applies=winds_up,
    separate="Use the whole range of torque on both sides, slowly and fast: an added belt is not"
    " proportional where the reducer's slope changes, and lags.",
)

K1_SOFTENING = Effect(
    name="k1_softening",
    family="elastic",
    scope="joint",
    equation="d += D(s; k1_factor*K1, t1_factor*T1) - D(s)",
    signature="wind-up off around zero torque that stops growing beyond the reducer's first corner",
    term=k1_softening_term,
    amplitudes=(WEIGHT,),
    shapes=(
        Shape(name="k1_factor", unit="", starts=(0.2, 0.35, 0.55, 0.8), lower=0.15, upper=1.2),
        Shape(name="t1_factor", unit="", starts=(0.7, 1.0, 1.6), lower=0.5, upper=3.0),
    ),
    report=_corners,
    applies=_has_corners,
    separate="Reach torques well beyond the first corner: a worn reducer stops getting softer"
    " there, loosened contacts keep growing, backlash has no width in torque.",
)

PRELOAD_LOSS = Effect(
    name="preload_loss",
    family="elastic",
    scope="joint",
    equation="d += c*((abs(s) + tp)^b - tp^b)*sgn(s)",
    signature="wind-up off that is steep around zero torque and keeps growing, ever more slowly",
    term=preload_loss_term,
    amplitudes=(Amplitude(name="c", unit="", scale=1.0, lower=0.0, upper=20.0),),
    shapes=(
        Shape(name="left", unit="", starts=(0.005, 0.05, 0.5), lower=5e-4, upper=10.0),
        Shape(name="power", unit="", starts=(0.35, 0.65), lower=0.3, upper=0.9),
    ),
    report=_preload_left,
    units={"tp": "N m"},
    applies=winds_up,
    separate="Climb to the rated torque on both sides in steps: loosened contacts stiffen all the"
    " way, a worn reducer only up to its corner.",
)

BELT_CREEP = Effect(
    name="belt_creep",
    family="elastic",
    scope="joint",
    equation="d += C_now*s + C_creep*y, dy/dt = (s - y)/tau_r",
    signature="added wind-up that lags the load by a fixed time",
    term=belt_creep_term,
    amplitudes=(
        Amplitude(name="C_now", unit="rad/(N m)", scale=working_compliance, lower=0.0, upper=2.0),
        Amplitude(name="C_creep", unit="rad/(N m)", scale=working_compliance, lower=0.0, upper=2.0),
    ),
    shapes=(Shape(name="tau_r", unit="s", starts=(0.03, 0.1, 0.3, 1.0), lower=0.01, upper=5.0),),
    report=_belt,
    units={"C": "rad/(N m)"},
    applies=_may_have_belt,
    separate="Run one path fast and slowly: creep shows in the difference, a plain change of"
    " stiffness and hysteresis do not.",
)

ELASTIC = (
    BACKLASH,
    HYSTERESIS,
    STIFFNESS_LINEAR,
    K1_SOFTENING,
    PRELOAD_LOSS,
    BELT_CREEP,
)
