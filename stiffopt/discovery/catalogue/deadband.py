"""Deadband of a position controller: errors within it ask for no torque."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointSignals

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
