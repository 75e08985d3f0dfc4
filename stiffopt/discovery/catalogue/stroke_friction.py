"""Friction over part of a stroke: between two angles, or from one to the end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.discovery.catalogue.common import dry_friction
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import JointConstants, JointSignals

# Angle over which the friction sets in [rad].
_EDGE_WIDTH = 0.02
# Least and largest share of the stroke between the angles: less is a tight place, more is dry
# friction everywhere.
_MIN_SHARE, _MAX_SHARE = 0.1, 0.85
# Angles that are tried, as shares of the stroke; those beyond it leave one edge.
_FIRST_SHARES, _LAST_SHARES = (-0.05, 0.25, 0.5, 0.75), (0.3, 0.6, 1.05)


def stroke_friction_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return dry friction A sg(w) between two angles, with rounded edges."""
    first, last = shapes
    q = signals.link_position
    inside = 0.5 * (np.tanh((q - first) / _EDGE_WIDTH) - np.tanh((q - last) / _EDGE_WIDTH))
    return Term(drive_torque=amplitudes[0] * inside * signals.motor_direction)


def _start_angles(shares: Sequence[float], constants: JointConstants) -> tuple[float, ...]:
    low, high = constants.stroke
    return tuple(low + share * (high - low) for share in shares)


def _is_part_of_stroke(shapes: Values, constants: JointConstants) -> bool:
    low, high = constants.stroke
    first, last = (min(max(angle, low), high) for angle in shapes)
    return bool(_MIN_SHARE <= (last - first) / max(high - low, 1e-9) <= _MAX_SHARE)


STROKE_FRICTION = Effect(
    name="stroke_friction",
    family="friction",
    scope="joint",
    equation="tau += A*sg(w) where q0 < q < q1",
    signature="motor torque too high against the motion over one part of the stroke, alike"
    " everywhere in it",
    title="friction over part of the stroke",
    phrase=(
        "more dry friction over part of the stroke: look for a cable, seal or guard that rubs",
        "less dry friction over part of the stroke",
    ),
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
