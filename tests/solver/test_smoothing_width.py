"""Smoothing width of the motor law at kinks of a joint's stiffness."""

from types import SimpleNamespace

import pytest

from stiffopt.command.smoothing_width import (
    motors_with_sufficient_smoothing,
    narrowest_sufficient_width,
)
from stiffopt.solver import exact_rows


@pytest.mark.parametrize("needed", [0.25, 1.7, 4.0])
def test_smoothing_is_as_wide_as_the_jerk_limit_needs(needed):
    # Jerk is proportional to the inverse square of the width; a width represents the motion.
    def excess(width):
        return (needed / width) ** 2 - 1.0

    found = motors_with_sufficient_smoothing(lambda width: width, excess, 0.25, 0.0)
    assert needed <= found < 2.0 * needed


def test_excess_independent_of_width_stays_narrow():
    assert (
        motors_with_sufficient_smoothing(lambda width: width, lambda width: 3.0, 0.25, 0.0) == 0.25
    )


@pytest.mark.parametrize(("needed", "found"), [(0.2, 0.5), (1.4, 1.0), (1.5, 2.0), (6.0, 8.0)])
def test_tolerable_excess_keeps_the_narrowest_width(needed, found):
    assert narrowest_sufficient_width(lambda width: (needed / width) ** 2 - 1.0, 0.5, 1.0) == found


def test_excess_independent_of_width_is_no_kink():
    assert narrowest_sufficient_width(lambda width: 7.0 + 0.1 / width, 0.5, 1.0) == 0.5


@pytest.mark.parametrize(
    ("excess", "corners"),
    [
        (lambda width: (100.0 / width) ** 2 - 1.0, 128.0),
        # Of a joint whose stiffness has no corner.
        (lambda width: 0.4, 4.0),
        (lambda width: 0.4 - 1e-3 * width, 4.0),
    ],
)
def test_smoothing_widens_for_kink_excess_only(monkeypatch, excess, corners):
    outcome = SimpleNamespace(smoothing=SimpleNamespace(lead=4.0))

    def motors(run, outcome, share, *, sagged):
        return share * outcome.smoothing.lead

    def drives(problem, width):
        return [SimpleNamespace(value=-0.1), SimpleNamespace(value=excess(width))]

    monkeypatch.setattr(exact_rows, "motors_with_law", motors)
    monkeypatch.setattr(exact_rows, "drive_violations", drives)
    assert exact_rows._widen_motor_smoothing(SimpleNamespace(problem=None), outcome) == corners
