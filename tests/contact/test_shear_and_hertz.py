from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from formula_checks import check_derivative, check_monotone
from scipy.integrate import quad
from surfaces import FINE

from stiffopt.connection.gear_pair import mean_pressure
from stiffopt.contact.shear import (
    SLIP_LIMIT,
    shear_softening,
    shear_travel,
)
from stiffopt.contact.surrogate import PowerLaw, fit_log_cubic

LAW = fit_log_cubic(FINE)
PRESSURE = 60e6


@pytest.mark.parametrize(
    ("shear", "ratio", "expected"),
    # Published for a power law with m = 0.86, two digits.
    [("mindlin", 0.5, 0.79), ("mindlin", 0.25, 0.91), ("load", 0.5, 0.55), ("load", 0.25, 0.78)],
)
def test_loss_of_stiffness_under_shear(shear: str, ratio: float, expected: float) -> None:
    law = PowerLaw(1.8e12, 0.86)
    found = 1 / shear_softening(law, PRESSURE, ratio, shear)
    assert found == pytest.approx(expected, abs=0.006)


@pytest.mark.parametrize("shear", ["mindlin", "load"])
def test_travel_is_the_integral_of_softening(shear: str) -> None:
    for ratio in (0.01, 0.4, 0.9, 0.97, 1.3):
        edges = sorted({0.0, min(ratio, SLIP_LIMIT), ratio})
        expected = sum(
            quad(lambda t: shear_softening(LAW, PRESSURE, t, shear), a, b, epsrel=1e-11)[0]
            for a, b in pairwise(edges)
        )
        assert shear_travel(LAW, PRESSURE, ratio, shear) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("shear", ["mindlin", "load"])
def test_travel_continues_past_slip(shear: str) -> None:
    ratios = np.linspace(0.0, 3.0, 301)
    travel = shear_travel(LAW, PRESSURE, ratios, shear)
    assert np.all(np.isfinite(travel))
    check_monotone(lambda t: shear_travel(LAW, PRESSURE, t, shear), ratios)
    check_monotone(lambda t: shear_softening(LAW, PRESSURE, t, shear), ratios)
    # Slope and curvature of the travel pass the joint without a step.
    below, at, above = (
        shear_softening(LAW, PRESSURE, SLIP_LIMIT + step, shear) for step in (-1e-6, 0.0, 1e-6)
    )
    assert at - below == pytest.approx(above - at, rel=1e-4)
    check_derivative(
        lambda t: shear_travel(LAW, PRESSURE, t, shear),
        lambda t: shear_softening(LAW, PRESSURE, t, shear),
        [0.05, 0.3, 0.8, 0.9, 1.1, 2.0],
        scale=0.05,
    )


def test_mindlin_travel_at_slip_limit() -> None:
    assert shear_travel(LAW, PRESSURE, 0.5, "mindlin") == pytest.approx(
        1.5 * (1 - 0.5 ** (2 / 3)), rel=1e-14
    )


def test_line_contact_against_hand_computation() -> None:
    # 100 N/mm on R = 10 mm steel: b = sqrt(4 * 1e5 * 0.01/(pi * 115.4e9)) = 0.10504 mm.
    width = 1.05047e-4
    assert mean_pressure(1e5, 0.01, 115.3846e9) == pytest.approx(1e5 / (2 * width), rel=1e-5)
    peak = math.sqrt(1e5 * 115.3846e9 / (math.pi * 0.01))
    assert mean_pressure(1e5, 0.01, 115.3846e9) == pytest.approx(math.pi / 4 * peak, rel=1e-6)
