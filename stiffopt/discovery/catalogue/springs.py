"""Springs parallel to a joint: balancers, cables along the arm, end stops."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import (
    Constants,
    along_stroke,
    carried_share,
    on_wrist,
    ratio_or_zero,
)
from stiffopt.discovery.effect import Amplitude, Effect, Reported, Shape, Term, Values
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.symbolic import softplus

# Angle over which a stop sets in [rad].
_STOP_ROUNDING = 2e-3


def gravity_spring_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return k m sin((q - q1)/m) + B of a balancer spring, sine and cosine separate."""
    sine, cosine, constant = amplitudes
    bend = shapes[0]
    turned = signals.link_position / bend
    return Term(link_torque=bend * (sine * np.sin(turned) + cosine * np.cos(turned)) + constant)


def cable_spring_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the torque k1 (q - q0) + k3 (q - q0)^3."""
    bent = signals.link_position - shapes[0]
    return Term(link_torque=amplitudes[0] * bent + amplitudes[1] * bent**3)


def end_stop_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the torque k (q - q0) beyond an angle, on the side of the second shape's sign."""
    place, side = shapes
    inwards = np.sign(side)
    pressed = softplus(inwards * (signals.link_position - place) / _STOP_ROUNDING)
    return Term(link_torque=amplitudes[0] * inwards * _STOP_ROUNDING * pressed)


def _report_rest_angle(amplitudes: Values, shapes: Values, constants: Constants) -> Reported:
    """Return the stiffness at the torque-free angle nearest to the stroke.

    Without a torque-free angle, that of the wave alone.
    """
    sine, cosine, constant = amplitudes
    bend, middle = shapes[0], float(np.mean(constants.stroke))
    size = float(np.hypot(sine, cosine))
    level = -ratio_or_zero(constant, bend * size)
    first = float(np.arcsin(level)) if abs(level) <= 1.0 else 0.0
    begin = -float(np.arctan2(cosine, sine))
    angles = []
    for turn in (first, np.pi - first):
        whole = round((middle / bend - begin - turn) / (2.0 * np.pi))
        angles.append((bend * (begin + turn + 2.0 * np.pi * whole), float(np.cos(turn))))
    offset, side = min(angles, key=lambda pair: abs(pair[0] - middle))
    return {"k": size * side, "offset": offset}


def _typical_stiffness(constants: JointConstants) -> float:
    return 0.1 * constants.torque_rated


GRAVITY_SPRING = Effect(
    name="gravity_spring",
    family="spring",
    scope="joint",
    equation="s += k*m*sin((q - q1)/m) + B",
    signature="link torque of one joint off along its own angle, whatever the other joints do",
    phrase="a counterbalance other than in the model, {k}",
    remedy="Check the counterbalance of {where}: spring, pressure, hinge; enter its stiffness.",
    needs=("torque", "moves"),
    confused_with=("cable_spring",),
    twin="cable_spring",
    term=gravity_spring_term,
    amplitudes=(
        Amplitude("k_sin", "N m/rad", _typical_stiffness, -20.0, 20.0),
        Amplitude("k_cos", "N m/rad", _typical_stiffness, -20.0, 20.0),
        Amplitude("B", "N m", _typical_stiffness, -40.0, 40.0),
    ),
    # From a crank with a spring of zero free length to a plain torsion spring.
    shapes=(Shape("m", "rad", (1.0, 1.5, 5.0), 0.5, 10.0),),
    report=_report_rest_angle,
    units={"k": "N m/rad", "offset": "rad"},
    log_prior=lambda constants: -1.0 if on_wrist(constants) else 0.0,
    separate="Go to both ends of the stroke with the next joint still, then move that one alone: a"
    " cable pulls ever harder towards the ends and a balancer ever less; the torque of a payload"
    " changes with the next joint, that of a balancer does not.",
)

CABLE_SPRING = Effect(
    name="cable_spring",
    family="spring",
    scope="joint",
    equation="s += k1*(q - q0) + k3*(q - q0)^3",
    signature="link torque of one joint off along its own angle, most at the ends of its stroke",
    phrase="cables that pull like a spring, {k1}",
    remedy="Look at hoses and cables over {where}, and give them slack.",
    needs=("torque", "moves"),
    term=cable_spring_term,
    amplitudes=(
        Amplitude("k1", "N m/rad", _typical_stiffness, 0.0, 5.0),
        Amplitude("k3", "N m/rad^3", _typical_stiffness, 0.0, 5.0),
    ),
    shapes=(Shape("q0", "rad", lambda constants: along_stroke(constants, 5), -20.0, 20.0),),
    log_prior=lambda constants: 0.0 if on_wrist(constants) else -1.0,
    separate="Go to both ends of the stroke: a cable pulls back ever harder, weight repeats after"
    " a turn.",
)

END_STOP = Effect(
    name="end_stop",
    family="spring",
    scope="joint",
    only_changed=True,
    equation="s += k*(q - q0) beyond q0",
    signature="link torque of one joint that sets in at one angle and grows beyond it",
    phrase="an end stop within the stroke, at {q0}",
    remedy="Look for an obstacle or stop of {where} at {q0}, and keep the motion short of it.",
    needs=("torque", "moves"),
    confused_with=("cable_spring",),
    term=end_stop_term,
    amplitudes=(
        Amplitude(
            "k",
            "N m/rad",
            lambda constants: 10.0 * carried_share(constants) * constants.torque_rated,
            0.0,
            100.0,
        ),
    ),
    shapes=(
        Shape("q0", "rad", lambda constants: along_stroke(constants, 6), -20.0, 20.0),
        Shape("side", "", (-1.0, 1.0), -1.0, 1.0, reported=False),
    ),
    possible=lambda shapes, constants: constants.stroke[0] <= shapes[0] <= constants.stroke[1],
    separate="Go to that end of the stroke slowly, and stop short of it: a stop has no effect short"
    " of its angle, cables and weight pull everywhere.",
)

SPRINGS = (GRAVITY_SPRING, CABLE_SPRING, END_STOP)
