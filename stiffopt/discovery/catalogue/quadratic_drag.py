"""Drag with the square of speed: churned oil, air, or a fan on the shaft."""

from __future__ import annotations

from stiffopt.discovery.catalogue.common import viscous_friction
from stiffopt.discovery.catalogue.friction import rounded_speed
from stiffopt.discovery.effect import Amplitude, Effect, Term, Values
from stiffopt.discovery.signals import JointSignals


def quadratic_drag_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return drag D w |w|."""
    w = signals.motor_velocity
    return Term(drive_torque=amplitudes[0] * w * rounded_speed(w))


QUADRATIC_DRAG = Effect(
    name="quadratic_drag",
    family="friction",
    scope="joint",
    equation="tau += D*w*abs(w)",
    signature="motor torque off against the motion by an amount that grows with the square of the"
    " speed",
    title="drag with the square of speed",
    phrase=(
        "drag that grows with the square of speed: check the oil level and grade",
        "friction that grows less than in proportion to speed",
    ),
    needs=("torque", "moves", "speeds"),
    confused_with=("viscous", "lubricated_friction"),
    reference="BittencourtAxelsson2014",
    term=quadratic_drag_term,
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
