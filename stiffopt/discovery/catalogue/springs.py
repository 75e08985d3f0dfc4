"""Springs beside a joint: balancers of the arm and cables along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stiffopt.discovery.catalogue.common import Constants, along_stroke, on_wrist, ratio_or_zero
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.symbolic import Quantity


def gravity_spring_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Torque k (q - offset), its moment at q = 0 an amplitude of its own."""
    return Term(link_torque=amplitudes[0] * signals.link_position - amplitudes[1])


def cable_spring_term(
    signals: JointSignals, amplitudes: Sequence[Quantity], shapes: Sequence[Quantity]
) -> Term:
    """Torque k1 (q - q0) + k3 (q - q0)^3."""
    bent = signals.link_position - shapes[0]
    return Term(link_torque=amplitudes[0] * bent + amplitudes[1] * bent**3)


def _rest_angle(
    amplitudes: Sequence[float], shapes: Sequence[float], constants: Constants
) -> Mapping[str, float]:
    return {"k": amplitudes[0], "offset": ratio_or_zero(amplitudes[1], amplitudes[0])}


def _share_of_rated(constants: JointConstants) -> float:
    return 0.1 * constants.torque_rated


def _middles(constants: JointConstants) -> tuple[float, ...]:
    return along_stroke(constants, 5)


GRAVITY_SPRING = Effect(
    name="gravity_spring",
    family="spring",
    scope="joint",
    equation="s += k*(q - offset)",
    signature="link torque of one joint off along its own angle, whatever the other joints do",
    term=gravity_spring_term,
    amplitudes=(
        Amplitude(name="k", unit="N m/rad", scale=_share_of_rated, lower=-20.0, upper=20.0),
        Amplitude(name="k_offset", unit="N m", scale=_share_of_rated, lower=-40.0, upper=40.0),
    ),
    report=_rest_angle,
    units={"offset": "rad"},
    log_prior=lambda constants: -1.0 if on_wrist(constants) else 0.0,
    separate="Move the next joint with this one still: the torque of a payload changes, that of a"
    " balancer does not.",
)

CABLE_SPRING = Effect(
    name="cable_spring",
    family="spring",
    scope="joint",
    equation="s += k1*(q - q0) + k3*(q - q0)^3",
    signature="link torque of one joint off along its own angle, most at the ends of its stroke",
    term=cable_spring_term,
    amplitudes=(
        Amplitude(name="k1", unit="N m/rad", scale=_share_of_rated, lower=0.0, upper=5.0),
        Amplitude(name="k3", unit="N m/rad^3", scale=_share_of_rated, lower=0.0, upper=5.0),
    ),
    shapes=(Shape(name="q0", unit="rad", starts=_middles, lower=-20.0, upper=20.0),),
    log_prior=lambda constants: 0.0 if on_wrist(constants) else -1.0,
    separate="Go to both ends of the stroke: a cable pulls back ever harder, weight repeats after"
    " a turn.",
)

SPRINGS = (GRAVITY_SPRING, CABLE_SPRING)
