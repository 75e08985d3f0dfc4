"""Tangential stiffness of a pressed contact under shear, up to slip.

t is the shear load over the slip load. Two laws: Mindlin's, every spot carries the same share of
its own slip load, k_t = kappa k_n(p) (1-t)^(1/3); and Ciavarella-Jaeger's, exact for elastic rough
contacts under monotonic shear at constant pressure, k_t = kappa k_n(p (1-t)), which for
k_n ~ p^m is (1-t)^m.

Sources: Mindlin, J. Appl. Mech. 16 (1949) 259; Ciavarella, J. Appl. Mech. 65 (1998) 998;
Jaeger, Arch. Appl. Mech. 65 (1995) 478.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from stiffopt.contact.surrogate import ContactLaw
from stiffopt.declaration import Doc
from stiffopt.symbolic import Quantity

# Up to this share of the slip load the laws hold as written; beyond it the travel continues as a
# parabola (value, slope and curvature continuous), so that it stays finite at and past slip while
# the compliance keeps growing.
SLIP_LIMIT = 0.95

ShearLaw = Annotated[
    Literal["mindlin", "load"],
    Doc("Law of contacts under shear: Mindlin's, or Ciavarella and Jaeger's for elastic contacts."),
]
# k_t ~ (1 - t)^(1/3).
_MINDLIN_EXPONENT = 1.0 / 3.0


def shear_travel(
    law: ContactLaw, pressure: Quantity, load_ratio: Quantity, shear: ShearLaw
) -> Quantity:
    """Integral of dt k_n(p)/k(t): tangential travel without slip would be t, under slip more.

    For a nominal pressure p > 0 [Pa] and a shear load over slip load, which the law holds for up to
    0.95. The dimensionless travel times slip traction over kappa k_n(p) is the travel in metres.
    """
    held = np.minimum(load_ratio, SLIP_LIMIT)
    beyond = load_ratio - held
    rest_limit = 1 - SLIP_LIMIT
    if shear == "mindlin":
        travel = (1 - (1 - held) ** (1 - _MINDLIN_EXPONENT)) / (1 - _MINDLIN_EXPONENT)
        slope = rest_limit**-_MINDLIN_EXPONENT
        curvature = _MINDLIN_EXPONENT * slope / rest_limit
    else:
        stiffness = law.stiffness(pressure)
        travel = stiffness / pressure * law.approach(pressure * (1 - held), pressure)
        slope = stiffness / law.stiffness(pressure * rest_limit)
        curvature = law.log_slope(pressure * rest_limit) * slope / rest_limit
    return travel + beyond * (slope + 0.5 * beyond * curvature)


def shear_softening(
    law: ContactLaw, pressure: Quantity, load_ratio: Quantity, shear: ShearLaw
) -> Quantity:
    """Slope of `shear_travel` over t: compliance over its value without shear, 1 at t = 0."""
    held = np.minimum(load_ratio, SLIP_LIMIT)
    beyond = load_ratio - held
    rest_limit = 1 - SLIP_LIMIT
    if shear == "mindlin":
        slope = (1 - held) ** -_MINDLIN_EXPONENT
        curvature = _MINDLIN_EXPONENT * rest_limit ** (-_MINDLIN_EXPONENT - 1)
    else:
        stiffness = law.stiffness(pressure)
        slope = stiffness / law.stiffness(pressure * (1 - held))
        limit = pressure * rest_limit
        curvature = law.log_slope(limit) * stiffness / law.stiffness(limit) / rest_limit
    return slope + beyond * curvature
