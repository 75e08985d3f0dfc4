"""Smooth functions, typical sizes and starts that the effects share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stiffopt.discovery.effect import Amplitude
from stiffopt.discovery.signals import JointConstants
from stiffopt.symbolic import Quantity, is_symbolic

# A term that no parameter enters linearly is scaled as a whole by this one. It is 1 where the
# shapes hold exactly, so a refined fit sets it to 1 and reports only the shapes.
WEIGHT = Amplitude(name="weight", unit="", scale=1.0, lower=0.0, upper=1.5)

# How many times larger than what a robot is wrong by as it was built something is that broke, was
# exchanged or set wrongly since.
CHANGED_SCALE_RATIO = 3.0

# The last joint of a wrist carries a thirteenth of what it is rated for: a rating speaks of a joint
# up to so many times the largest torque met. From the square of that on it is a placeholder.
_MAX_RATED_OVER_CARRIED = 15.0


def component(signal: Quantity, index: int) -> Quantity:
    """One entry along the last axis of arrays (K, n, m), or column of a symbol (n, m)."""
    return signal[:, index] if is_symbolic(signal) else signal[..., index]


# ---- typical sizes, from what is known of a joint


def dry_friction(constants: JointConstants) -> float:
    """Coulomb level, or what a geared joint usually has [N m]."""
    return constants.coulomb if constants.coulomb > 0.0 else 0.08 * constants.torque_rated


def viscous_friction(constants: JointConstants) -> float:
    """Viscous coefficient, or what a geared joint usually has [N m s/rad]."""
    usual = 0.08 * constants.torque_rated / max(constants.fastest, 1e-3)
    return constants.viscous if constants.viscous > 0.0 else usual


def motor_inertia(constants: JointConstants) -> float:
    """Rotor inertia at the output side, or what a geared joint usually has [kg m^2]."""
    usual = 0.01 * constants.torque_rated
    return constants.rotor_inertia if constants.rotor_inertia > 0.0 else usual


def working_compliance(constants: JointConstants) -> float:
    """Slope of the nominal wind-up between the corners of the reducer [rad/(N m)]."""
    contacts = 1.0 / constants.contact_stiffness
    return contacts if constants.slopes is None else contacts + 1.0 / constants.slopes[1]


def contact_compliance(constants: JointConstants) -> float:
    """Of the healthy connections; a fifth of the reducer's where unknown [rad/(N m)]."""
    if np.isfinite(constants.contact_stiffness):
        return 1.0 / constants.contact_stiffness
    return 0.2 * working_compliance(constants)


def winds_up(constants: JointConstants) -> bool:
    """Whether the nominal joint is elastic at all."""
    return constants.elastic


def carried_share(constants: JointConstants) -> float:
    """Largest torque met over the rated one, where that is a placeholder; 1 where it speaks.

    Shapes that are shares of a rated torque begin so much smaller there. Between the two it falls
    with the square: no joint lies on one side or the other by chance.
    """
    carried = constants.largest_torque / constants.torque_rated
    return min(1.0, max(carried, (_MAX_RATED_OVER_CARRIED * carried) ** 2))


def along_stroke(constants: JointConstants, count: int) -> tuple[float, ...]:
    """Places evenly over the stroke met, each in the middle of its share [rad]."""
    low, high = constants.stroke
    shares = (np.arange(count) + 0.5) / count
    return tuple(float(x) for x in low + shares * (high - low))


def ratio_or_zero(top: float, bottom: float) -> float:
    """Quotient that is 0 where there is nothing to divide by."""
    return top / bottom if bottom != 0.0 else 0.0


def on_wrist(constants: JointConstants) -> bool:
    """Whether a joint is one of the last three of a six-axis arm."""
    return constants.joint > 3


Reported = Mapping[str, float]
Constants = Any
