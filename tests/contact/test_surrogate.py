from __future__ import annotations

import math
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from surfaces import FINE, SURFACES

from stiffopt.contact.fractal import FractalLaw
from stiffopt.contact.surrogate import (
    LogCubic,
    PowerLaw,
    contact_law,
    fit_log_cubic,
    fit_power_law,
)
from stiffopt.errors import InputError, OutOfValidityError
from stiffopt.symbolic import elementwise_derivative

# Published one-term laws [N/m^3 at 1 MPa, -] and largest errors; least squares there, equal ripples
# here, so that the error must come out smaller and c, m close: 4 % and 0.008 are the spread between
# two fits of the same curve.
POWER_LAWS = {
    "fine": (1.80e12, 0.860, 0.022),
    "fine_2.3": (2.10e12, 0.776, 0.014),
    "fine_2.5": (1.57e12, 0.931, 0.034),
    "rough": (6.72e11, 0.879, 0.093),
    "fine_aluminium": (1.495e12, 0.860, 0.021),
    "fine_iron": (2.10e12, 0.858, 0.011),
}
DENSE = np.geomspace(0.1e6, 200e6, 3001)


def error(law: LogCubic | PowerLaw, name: str) -> float:
    exact = FractalLaw(SURFACES[name]).normal_stiffness_per_area(DENSE)
    return float(np.max(np.abs(law.stiffness(DENSE) / exact - 1)))


@pytest.mark.parametrize("name", SURFACES)
def test_log_cubic_is_within_one_and_a_half_percent(name: str) -> None:
    law = fit_log_cubic(SURFACES[name])
    assert (law.lower, law.upper) == (0.1e6, 200e6)
    assert error(law, name) <= 0.015
    # The error the law states is the true one, on other points than those of the fit.
    assert error(law, name) == pytest.approx(law.max_error, rel=0.02)


@pytest.mark.parametrize("name", POWER_LAWS)
def test_power_law(name: str) -> None:
    coefficient, exponent, largest = POWER_LAWS[name]
    law = fit_power_law(SURFACES[name])
    assert law.coefficient == pytest.approx(coefficient, rel=0.04)
    assert law.exponent == pytest.approx(exponent, abs=0.008)
    assert error(law, name) == pytest.approx(law.max_error, rel=0.02)
    assert law.max_error <= largest


def test_fit_agrees_with_published_cubic() -> None:
    # Coefficients of the fine steel surface, stated error 0.23 %; both within 0.45 % of each other.
    published = LogCubic((28.226182, 0.864130, -0.003457, 0.000428))
    assert error(published, "fine") < 0.0045
    np.testing.assert_allclose(
        published.stiffness(DENSE), fit_log_cubic(FINE).stiffness(DENSE), rtol=0.0045
    )


def test_fits_are_cached() -> None:
    assert fit_log_cubic(FINE) is fit_log_cubic(FINE)
    assert contact_law(FINE) is fit_log_cubic(FINE, 0.1e6, 200e6)
    own = PowerLaw(1.8e12, 0.86)
    assert contact_law(FINE, own) is own


@pytest.mark.parametrize("law", [fit_log_cubic(FINE), fit_power_law(FINE)], ids=["cubic", "power"])
@pytest.mark.parametrize(
    ("low", "high"), [(1e5, 1.001e5), (1e5, 2e8), (3e6, 5e7), (1e4, 3e6), (1e3, 5e4), (2e6, 1e9)]
)
def test_approach_is_the_integral_of_compliance(
    law: LogCubic | PowerLaw, low: float, high: float
) -> None:
    edges = [p for p in (1e5, 2e8) if low < p < high]
    edges = [low, *edges, high]
    expected = sum(
        quad(
            lambda x: math.exp(x) / law.stiffness(math.exp(x)),
            math.log(a),
            math.log(b),
            epsrel=1e-12,
            epsabs=0.0,
        )[0]
        for a, b in pairwise(edges)
    )
    assert law.approach(low, high) == pytest.approx(expected, rel=1e-8)


def test_approach_from_zero_pressure() -> None:
    law = fit_log_cubic(FINE)
    # Below the fit a pure power: p/(k_n (1-m)).
    below = 2e4 / (law.stiffness(2e4) * (1 - law.log_slope(2e4)))
    assert law.approach(0.0, 2e4) == pytest.approx(below, rel=1e-12)
    assert law.approach(0.0, 1e6) == pytest.approx(below + law.approach(2e4, 1e6), rel=1e-9)


@pytest.mark.parametrize("law", [fit_log_cubic(FINE), fit_power_law(FINE)], ids=["cubic", "power"])
@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_symbols_give_the_same_numbers(law: LogCubic | PowerLaw, symbol: type) -> None:
    pressures = np.geomspace(1e4, 1e9, 23)
    p = symbol.sym("p")
    function = ca.Function("f", [p], [law.stiffness(p), law.log_slope(p), law.approach(2e5, p)])
    found = np.array([[float(v) for v in function(value)] for value in pressures]).T
    np.testing.assert_allclose(found[0], law.stiffness(pressures), rtol=1e-13)
    np.testing.assert_allclose(found[1], law.log_slope(pressures), rtol=1e-13)
    np.testing.assert_allclose(found[2], law.approach(2e5, pressures), rtol=1e-11)


@pytest.mark.parametrize("law", [fit_log_cubic(FINE), fit_power_law(FINE)], ids=["cubic", "power"])
def test_derivatives(law: LogCubic | PowerLaw) -> None:
    pressures = np.geomspace(2e4, 9e8, 31)
    slope = elementwise_derivative(law.stiffness, pressures)
    np.testing.assert_allclose(
        slope * pressures / law.stiffness(pressures), law.log_slope(pressures), rtol=1e-12
    )
    compliance = elementwise_derivative(lambda p: law.approach(1e5, p), pressures)
    np.testing.assert_allclose(compliance, 1 / law.stiffness(pressures), rtol=1e-7)


def test_stiffness_grows_far_outside_the_fit() -> None:
    law = fit_log_cubic(FINE)
    pressures = np.geomspace(1e-3, 1e12, 500)
    assert np.all(np.diff(law.stiffness(pressures)) > 0.0)


def test_unusable_laws_are_refused() -> None:
    with pytest.raises(OutOfValidityError, match=r"exponent of stiffness in pressure = 1\.1"):
        PowerLaw(1e12, 1.1)
    with pytest.raises(InputError, match="coefficient = -1"):
        PowerLaw(-1.0, 0.8)
    with pytest.raises(InputError, match="lower = 2e\\+06 must be smaller than upper = 1e\\+06"):
        fit_log_cubic(FINE, 2e6, 1e6)
    with pytest.raises(InputError, match=r"contact_law = 'log_cubik' is not known.*log_cubic"):
        contact_law(FINE, "log_cubik")
