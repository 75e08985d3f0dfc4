"""Smooth fits to the fractal law k_n(p), for floats, arrays and CasADi expressions.

A fit states its pressure range and its largest relative error there against the exact law. The
integral of 1/k_n over pressure, from which every wind-up follows, is part of the law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal, Protocol, get_args

import numpy as np

from stiffopt.contact.fractal import FractalLaw
from stiffopt.contact.surface import LOWEST_PRESSURE, SurfacePair
from stiffopt.contact.validate import require_one_of, require_ordered, require_positive
from stiffopt.declaration import Doc
from stiffopt.errors import OutOfValidityError
from stiffopt.symbolic import Quantity

# Upper end of the fits [Pa], and the unit of pressure in their logarithms [Pa].
HIGHEST_PRESSURE = 200e6
_UNIT_PRESSURE = 1e6
# Five Gauss-Legendre points integrate 1/k_n over three decades of pressure to about 1e-9, because
# in ln p the integrand is nearly an exponential.
_GAUSS_NODES, _GAUSS_WEIGHTS = (array.tolist() for array in np.polynomial.legendre.leggauss(5))
# Minimax fit: pressures, equally spaced in ln p, and iterations of Lawson's reweighting.
_FIT_POINTS = 400
_LAWSON_ITERATIONS = 60

_LawNames = Literal["log_cubic", "power_law"]
LawName = Annotated[
    _LawNames,
    Doc("Smooth law that is fitted to the stiffness of rough contacts over pressure."),
]


class ContactLaw(Protocol):
    """Normal stiffness per area of a contact as a smooth function of pressure."""

    @property
    def lower(self) -> float:
        """Lowest pressure of the fit [Pa]."""

    @property
    def upper(self) -> float:
        """Highest pressure of the fit [Pa]."""

    @property
    def max_error(self) -> float:
        """Largest relative error against the exact law between `lower` and `upper` [-]."""

    def stiffness(self, pressure: Quantity) -> Quantity:
        """Stiffness per area k_n(p), normal [N/m^3]."""

    def log_slope(self, pressure: Quantity) -> Quantity:
        """Local exponent d ln k_n / d ln p [-]."""

    def approach(self, low: Quantity, high: Quantity) -> Quantity:
        """Integral of dp/k_n from `low` to `high` [m]: approach of the surfaces."""


@dataclass(frozen=True)
class PowerLaw:
    """k_n = c (p / 1 MPa)^m."""

    coefficient: float  # c, stiffness per area at 1 MPa [N/m^3]
    # m, above 0 and below 1 (otherwise the surfaces would approach without end at p -> 0).
    exponent: float
    # Range of the fit [Pa].
    lower: float = LOWEST_PRESSURE
    upper: float = HIGHEST_PRESSURE
    max_error: float = math.nan  # largest relative error in it [-]

    def __post_init__(self) -> None:
        require_positive("power law", coefficient=self.coefficient)
        _require_integrable("power law", self.exponent)

    def stiffness(self, pressure: Quantity) -> Quantity:
        """Stiffness per area k_n(p), normal [N/m^3]."""
        return self.coefficient * (pressure / _UNIT_PRESSURE) ** self.exponent

    def log_slope(self, pressure: Quantity) -> Quantity:
        """Local exponent d ln k_n / d ln p [-]."""
        return self.exponent + 0.0 * pressure

    def approach(self, low: Quantity, high: Quantity) -> Quantity:
        """Integral of dp/k_n from `low` (0 is allowed) to `high` [m]."""
        power = 1 - self.exponent
        scale = _UNIT_PRESSURE / (self.coefficient * power)
        return scale * ((high / _UNIT_PRESSURE) ** power - (low / _UNIT_PRESSURE) ** power)


@dataclass(frozen=True)
class LogCubic:
    """ln k_n is a cubic of x = ln(p / 1 MPa); outside the range of the fit a straight line in x.

    The straight lines make k_n positive and growing for every pressure above zero. k_n has a
    continuous slope at the two joints, its integral a continuous second derivative.
    """

    # (4,) tuple: c0 .. c3 of ln(k_n / (N/m^3)) = c0 + c1 x + c2 x^2 + c3 x^3.
    coefficients: tuple[float, float, float, float]
    # Range of the fit [Pa].
    lower: float = LOWEST_PRESSURE
    upper: float = HIGHEST_PRESSURE
    max_error: float = math.nan  # largest relative error in it [-]

    def __post_init__(self) -> None:
        require_positive("log-cubic law", lower=self.lower, upper=self.upper)
        require_ordered("log-cubic law", lower=self.lower, upper=self.upper)
        for x in (self._extrapolate_low, self._extrapolate_high):
            _require_integrable("log-cubic law", self._cubic_slope(x))

    @property
    def _extrapolate_low(self) -> float:
        return math.log(self.lower / _UNIT_PRESSURE)

    @property
    def _extrapolate_high(self) -> float:
        return math.log(self.upper / _UNIT_PRESSURE)

    def _evaluate_cubic(self, x: Quantity) -> Quantity:
        c0, c1, c2, c3 = self.coefficients
        return c0 + x * (c1 + x * (c2 + x * c3))

    def _cubic_slope(self, x: Quantity) -> Quantity:
        _, c1, c2, c3 = self.coefficients
        return c1 + x * (2 * c2 + x * 3 * c3)

    def stiffness(self, pressure: Quantity) -> Quantity:
        """Stiffness per area k_n(p), normal [N/m^3]."""
        x = np.log(pressure / _UNIT_PRESSURE)
        inside = np.minimum(np.maximum(x, self._extrapolate_low), self._extrapolate_high)
        return np.exp(self._evaluate_cubic(inside) + self._cubic_slope(inside) * (x - inside))

    def log_slope(self, pressure: Quantity) -> Quantity:
        """Local exponent d ln k_n / d ln p [-]."""
        x = np.log(pressure / _UNIT_PRESSURE)
        return self._cubic_slope(
            np.minimum(np.maximum(x, self._extrapolate_low), self._extrapolate_high)
        )

    def approach(self, low: Quantity, high: Quantity) -> Quantity:
        """Integral of dp/k_n from `low` (0 is allowed) to `high` [m].

        Inside the range by Gauss-Legendre quadrature in ln p, outside in closed form.
        """
        first = np.minimum(np.maximum(low, self.lower), self.upper)
        last = np.minimum(np.maximum(high, self.lower), self.upper)
        start = np.log(first / _UNIT_PRESSURE)
        span = np.log(last / first)
        total = 0.0
        for node, weight in zip(_GAUSS_NODES, _GAUSS_WEIGHTS, strict=True):
            x = start + 0.5 * (1 + node) * span
            total = total + 0.5 * weight * np.exp(x - self._evaluate_cubic(x))
        inside = _UNIT_PRESSURE * span * total
        below = self._tangent_line(
            self._extrapolate_low, np.minimum(low, self.lower), np.minimum(high, self.lower)
        )
        above = self._tangent_line(
            self._extrapolate_high, np.maximum(low, self.upper), np.maximum(high, self.upper)
        )
        return below + inside + above

    def _tangent_line(self, x: float, low: Quantity, high: Quantity) -> Quantity:
        """Integral of dp/k_n where ln k_n is the tangent to the cubic at x."""
        tangent = PowerLaw(
            math.exp(self._evaluate_cubic(x) - self._cubic_slope(x) * x), self._cubic_slope(x)
        )
        return tangent.approach(low, high)


def _require_integrable(owner: str, exponent: float) -> None:
    if not 0.0 < exponent < 1.0:
        raise OutOfValidityError(
            f"{owner}: exponent of stiffness in pressure",
            exponent,
            0.0,
            1.0,
            "The wind-up would be infinite at light load; use another surface or another range.",
        )


@lru_cache(maxsize=128)
def fit_power_law(
    surface: SurfacePair, lower: float = LOWEST_PRESSURE, upper: float = HIGHEST_PRESSURE
) -> PowerLaw:
    """Power law with the smallest largest relative error from `lower` to `upper` [Pa]."""
    (constant, slope), error = _fit_log_polynomial(surface, lower, upper, 1)
    return PowerLaw(math.exp(constant), slope, lower, upper, error)


@lru_cache(maxsize=128)
def fit_log_cubic(
    surface: SurfacePair, lower: float = LOWEST_PRESSURE, upper: float = HIGHEST_PRESSURE
) -> LogCubic:
    """Log-cubic law with the smallest largest relative error from `lower` to `upper` [Pa]."""
    (c0, c1, c2, c3), error = _fit_log_polynomial(surface, lower, upper, 3)
    return LogCubic((c0, c1, c2, c3), lower, upper, error)


def require_law(owner: str, law: LawName | ContactLaw) -> None:
    """Raise `InputError` when `law` is a name that no fit has."""
    if isinstance(law, str):
        require_one_of(owner, get_args(_LawNames), contact_law=law)


def contact_law(
    surface: SurfacePair,
    law: LawName | ContactLaw = "log_cubic",
    lower: float = LOWEST_PRESSURE,
    upper: float = HIGHEST_PRESSURE,
) -> ContactLaw:
    """Fitted law of a surface by its name, "log_cubic" or "power_law"; a law passes through."""
    if not isinstance(law, str):
        return law
    require_law("contact", law)
    fit = fit_log_cubic if law == "log_cubic" else fit_power_law
    return fit(surface, lower, upper)


def _fit_log_polynomial(
    surface: SurfacePair, lower: float, upper: float, degree: int
) -> tuple[list[float], float]:
    """Coefficients of ln k_n over ln p (ascending) and the largest relative error."""
    require_positive("fit of a contact law", lower=lower, upper=upper)
    require_ordered("fit of a contact law", lower=lower, upper=upper)
    x = np.linspace(math.log(lower / _UNIT_PRESSURE), math.log(upper / _UNIT_PRESSURE), _FIT_POINTS)
    exact = np.log(FractalLaw(surface).normal_stiffness_per_area(np.exp(x) * _UNIT_PRESSURE))
    # Lawson's iteration: weights grow where the error is large, which ends at equal ripples.
    weight = np.full(x.size, 1 / x.size)
    best, best_error = np.zeros(degree + 1), math.inf
    for _ in range(_LAWSON_ITERATIONS):
        polynomial = np.polynomial.polynomial.polyfit(x, exact, degree, w=np.sqrt(weight))
        error = np.abs(np.expm1(np.polynomial.polynomial.polyval(x, polynomial) - exact))
        if error.max() < best_error:
            best, best_error = polynomial, float(error.max())
        weight = weight * error
        weight /= weight.sum()
    return [float(c) for c in best], best_error
