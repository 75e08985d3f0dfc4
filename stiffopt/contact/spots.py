"""Contact spots of a three-dimensional fractal surface: one spot, and the sum over all sizes.

A spot is named by its truncated area a' [m^2]. Each regime is a pure power of a', so the sums over
the size distribution n(a') = (D-1)/2 a_L^((D-1)/2) a'^(-(D+1)/2), 0 < a' <= a_L, have closed forms.

Sources: Yan and Komvopoulos, J. Appl. Phys. 84 (1998) 3617 (spots, sizes); Kogut and Etsion,
J. Appl. Mech. 69 (2002) 657 (elastic-plastic spots); Etsion, Kligerman and Kadin, Int. J. Solids
Struct. 42 (2005) 3716 (unloading is elastic).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from stiffopt.declaration import Doc
from stiffopt.errors import OutOfValidityError

# Kogut-Etsion fits: force factor and exponent of omega, and the interference range they hold in.
_KOGUT_ETSION_FORCE_FITS = ((1.03, 1.425, 6.0), (1.40, 1.263, 110.0))
# Their contact areas over that at yield, 0.93 omega^1.136 and 0.94 omega^1.146, as share of the
# truncated area, which is 2 omega of it: factor and exponent of omega.
_KOGUT_ETSION_AREA_FITS = ((0.93 / 2, 0.136), (0.94 / 2, 0.146))
# |ln(area/m^2)| beyond which the critical area is outside the range of doubles.
_MAX_LOG_AREA = 300.0

Loading = Annotated[
    Literal["first", "cyclic"],
    Doc(
        "Stiffness of rough contacts: of first loading, or cyclic, the tangent of unloading and of "
        "loading again below a load that was there before, 2.0 to 2.9 times as stiff."
    ),
]


@dataclass(frozen=True)
class SpotLaw:
    """Force and incremental normal stiffness of the spots of one regime."""

    # Range of the truncated area a' [m^2].
    lower: float
    upper: float
    # F = force_factor * a'^force_exponent [N].
    force_factor: float
    force_exponent: float
    # k = stiffness_factor * a'^stiffness_exponent [N/m].
    stiffness_factor: float
    stiffness_exponent: float


def spot_laws(
    dimension: float,
    roughness: float,
    gamma: float,
    modulus: float,
    hardness: float,
    poisson: float,
    *,
    loading: Loading = "first",
) -> tuple[SpotLaw, ...]:
    """Laws of plastic, elastic-plastic and elastic spots, from the smallest to the largest.

    Of a surface with fractal dimension 2 < D < 3, roughness G [m] and frequency ratio gamma > 1;
    contact modulus E* [Pa], hardness [Pa] and Poisson's ratio of the softer body. Cyclic loading:
    an elastic or elastic-plastic spot keeps its area a and deforms as an elastic punch, k = 2 E*
    sqrt(a/pi). Plastic spots remain without stiffness: the sum of theirs diverges towards small
    sizes of a fractal, so the cyclic stiffness is a lower bound. Raises `OutOfValidityError` for D
    very close to 2.
    """
    big_lambda = roughness ** (dimension - 2) * math.sqrt(math.log(gamma))
    yield_factor = 0.454 + 0.41 * poisson
    strain = yield_factor * math.pi * hardness / modulus
    log_limit = math.log(math.pi) + (
        (11 - 2 * dimension) * math.log(2) + 2 * math.log(big_lambda) - 2 * math.log(strain)
    ) / (dimension - 2)
    if abs(log_limit) > _MAX_LOG_AREA:
        raise OutOfValidityError(
            "ln of the elastic limit area of a spot",
            log_limit,
            -_MAX_LOG_AREA,
            _MAX_LOG_AREA,
            "Take a fractal dimension further from 2.",
        )
    limit = math.exp(log_limit)
    elastic_force = (
        2 ** ((11 - 2 * dimension) / 2)
        / (3 * math.pi ** ((4 - dimension) / 2))
        * big_lambda
        * modulus
    )
    elastic_stiffness = 2 * modulus / math.sqrt(2 * math.pi)
    elastic = SpotLaw(limit, math.inf, elastic_force, (4 - dimension) / 2, elastic_stiffness, 0.5)
    worn = _elastic_plastic_laws(dimension, big_lambda, modulus, hardness, yield_factor, limit)
    if loading == "cyclic":
        worn = _unloading_laws(worn, dimension, modulus, limit)
    laws = [elastic, *worn]
    laws.append(SpotLaw(0.0, laws[-1].lower, hardness, 1.0, 0.0, 0.0))
    return tuple(reversed(laws))


def _elastic_plastic_laws(
    dimension: float,
    big_lambda: float,
    modulus: float,
    hardness: float,
    yield_factor: float,
    limit: float,
) -> list[SpotLaw]:
    # Tip radius R = radius * a'^((D-1)/2); yield interference delta_ec is a multiple of R, and
    # omega = delta/delta_ec = (limit/a')^(D-2).
    radius = 1 / (math.pi ** ((dimension - 1) / 2) * 2 ** (5 - dimension) * big_lambda)
    pressure = yield_factor * math.pi * hardness
    yield_force = 2 / 3 * pressure * radius**2 * (pressure / (2 * modulus)) ** 2
    laws = []
    upper = limit
    for factor, exponent, largest in _KOGUT_ETSION_FORCE_FITS:
        lower = limit * largest ** (-1 / (dimension - 2))
        slope = dimension - 2
        laws.append(
            SpotLaw(
                lower,
                upper,
                factor * yield_force * limit ** (slope * exponent),
                dimension - 1 - slope * exponent,
                factor * exponent * 2 / 3 * pressure * radius * limit ** (slope * (exponent - 1)),
                (dimension - 1) / 2 - slope * (exponent - 1),
            )
        )
        upper = lower
    return laws


def _unloading_laws(
    laws: list[SpotLaw], dimension: float, modulus: float, limit: float
) -> list[SpotLaw]:
    """Return the laws with the stiffness of elastic punches of the spots' contact area."""
    slope = dimension - 2
    found = []
    for law, (share, exponent) in zip(laws, _KOGUT_ETSION_AREA_FITS, strict=True):
        # a = share a' omega^exponent with omega = (limit/a')^(D-2).
        factor = 2 * modulus * math.sqrt(share / math.pi) * limit ** (slope * exponent / 2)
        found.append(
            replace(law, stiffness_factor=factor, stiffness_exponent=(1 - slope * exponent) / 2)
        )
    return found


def total_force(laws: Sequence[SpotLaw], largest: np.ndarray, dimension: float) -> np.ndarray:
    """Sum of the spot forces up to the largest spot a_L [m^2]: total load [N], shape as `largest`.

    The special dimensions at which a power turns into a logarithm (2.5, 2.541.., 2.655..) need no
    case of their own: the integral is written with expm1.
    """
    return _sum_over_spots(
        [(law.lower, law.upper, law.force_factor, law.force_exponent) for law in laws],
        largest,
        dimension,
    )


def total_stiffness(laws: Sequence[SpotLaw], largest: np.ndarray, dimension: float) -> np.ndarray:
    """Sum of the spot stiffnesses up to the largest spot a_L [m^2]: normal stiffness [N/m]."""
    # Plastic spots carry load but add no incremental stiffness.
    return _sum_over_spots(
        [
            (law.lower, law.upper, law.stiffness_factor, law.stiffness_exponent)
            for law in laws
            if law.stiffness_factor > 0.0
        ],
        largest,
        dimension,
    )


def _sum_over_spots(
    powers: Sequence[tuple[float, float, float, float]], largest: np.ndarray, dimension: float
) -> np.ndarray:
    """Integral of factor * a'^exponent over the size distribution, regime by regime."""
    largest = np.asarray(largest, dtype=float)
    half = (dimension - 1) / 2
    result = np.zeros_like(largest)
    for lower, upper, factor, exponent in powers:
        power = exponent - half
        end = np.minimum(upper, largest)
        if lower == 0.0:
            integral = end**power / power
        else:
            span = np.log(np.maximum(end, lower) / lower)
            integral = lower**power * span * _relative_expm1(power * span)
        result += factor * half * largest**half * integral
    return result


def _relative_expm1(x: np.ndarray) -> np.ndarray:
    """(exp(x) - 1)/x, 1 at zero."""
    small = np.abs(x) < 1e-12
    return np.where(small, 1.0 + 0.5 * x, np.expm1(x) / np.where(small, 1.0, x))
