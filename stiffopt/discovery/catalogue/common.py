"""Smooth functions, typical sizes and initial values that effects share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg.lapack import dtbtrs

from stiffopt.discovery.effect import Amplitude
from stiffopt.discovery.signals import JointConstants

# Scale of a term without a linear parameter. It is 1 where the shapes hold exactly: a refined fit
# fixes it at 1 and reports only the shapes.
WEIGHT = Amplitude("weight", "", 1.0, 0.0, 1.5)

# Typical size of a change by breakage, exchange or wrong setting over that of an error as built.
CHANGED_SCALE_RATIO = 3.0

# Largest ratio of rated to carried torque for which the rating is taken as meaningful: the last
# joint of a wrist carries a thirteenth of its rating. From the square of the ratio on it is a
# placeholder.
_MAX_RATED_OVER_CARRIED = 15.0


# ---- typical sizes from the constants of a joint


def dry_friction(constants: JointConstants) -> float:
    """Return the Coulomb friction, stated, shown or that of a usual geared joint [N m]."""
    usual = max(0.08 * constants.torque_rated, constants.shown_coulomb)
    return constants.coulomb if constants.coulomb > 0.0 else usual


def viscous_friction(constants: JointConstants) -> float:
    """Return the viscous coefficient, stated, shown or that of a usual geared joint [N m s/rad]."""
    geared = 0.08 * constants.torque_rated / max(constants.fastest, 1e-3)
    usual = max(geared, constants.shown_viscous)
    return constants.viscous if constants.viscous > 0.0 else usual


def motor_inertia(constants: JointConstants) -> float:
    """Return the rotor inertia at the joint, or that of a usual geared joint [kg m^2]."""
    usual = 0.01 * constants.torque_rated
    return constants.rotor_inertia if constants.rotor_inertia > 0.0 else usual


def working_compliance(constants: JointConstants) -> float:
    """Return the tangent compliance between the corners of the reducer [rad/(N m)]."""
    contacts = 1.0 / constants.contact_stiffness
    return contacts if constants.slopes is None else contacts + 1.0 / constants.slopes[1]


def contact_compliance(constants: JointConstants) -> float:
    """Return that of healthy connections; default: a fifth of the reducer's [rad/(N m)]."""
    if np.isfinite(constants.contact_stiffness):
        return 1.0 / constants.contact_stiffness
    return 0.2 * working_compliance(constants)


def winds_up(constants: JointConstants) -> bool:
    """Return True for a joint with elastic nominal model."""
    return constants.elastic


def carried_share(constants: JointConstants) -> float:
    """Return the largest carried torque over the rated one if that is a placeholder, or 1.

    Initial shapes that are shares of a rated torque are smaller by this factor. The transition is
    quadratic, so that no joint is classified by chance.
    """
    carried = constants.largest_torque / constants.torque_rated
    return min(1.0, max(carried, (_MAX_RATED_OVER_CARRIED * carried) ** 2))


def shares_of_carried(*shares: float) -> Callable[[JointConstants], tuple[float, ...]]:
    """Return the initial shapes that are shares of a rated torque, as of a meaningful rating."""
    return lambda constants: tuple(carried_share(constants) * share for share in shares)


def symmetric_amplitude(name: str, unit: str, typical: float, most: float) -> Amplitude:
    """Return an amplitude of a typical size within bounds alike in both directions."""
    return Amplitude(name, unit, typical, -most / typical, most / typical)


def along_stroke(constants: JointConstants, count: int) -> tuple[float, ...]:
    """Return angles at the centres of equal parts of the stroke [rad]."""
    low, high = constants.stroke
    shares = (np.arange(count) + 0.5) / count
    return tuple(float(x) for x in low + shares * (high - low))


def ratio_or_zero(top: float, bottom: float) -> float:
    """Return the quotient, or 0 for a zero divisor."""
    return top / bottom if bottom != 0.0 else 0.0


def on_wrist(constants: JointConstants) -> bool:
    """Return True for one of the last three joints of a six-axis arm."""
    return constants.joint > 3


Constants = Any


# ---- recurrences over samples, of effects with memory


def first_order_lag(values: np.ndarray, kept: float) -> np.ndarray:
    """Return the first-order lag of signals (K, ...); a step keeps the share `kept`.

    x_k = kept x_k-1 + (1 - kept) values_k from values_0 on, by bidiagonal equations.
    """
    added = (1.0 - kept) * values
    added[0] = values[0]
    band = np.ones((2, len(added)))
    band[1, :-1] = -kept
    return np.asarray(dtbtrs(band, added, uplo="L", diag="U")[0])
