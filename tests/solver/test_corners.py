"""Widths of the motors' law at the corners of a joint's stiffness."""

from types import SimpleNamespace

import pytest

from stiffopt.solver import refinement
from stiffopt.solver.corners import narrowest, widened


@pytest.mark.parametrize("needed", [0.25, 1.7, 4.0])
def test_corners_are_as_wide_as_the_jerk_needs(needed):
    # Jerk goes with one over the square of the width; a width stands for the motion here.
    def excess(width):
        return (needed / width) ** 2 - 1.0

    found = widened(lambda width: width, excess, 0.25, 0.0)
    assert needed <= found < 2.0 * needed


def test_what_no_width_mends_stays_narrow():
    assert widened(lambda width: width, lambda width: 3.0, 0.25, 0.0) == 0.25


@pytest.mark.parametrize(("needed", "found"), [(0.2, 0.5), (1.4, 1.0), (1.5, 2.0), (6.0, 8.0)])
def test_a_solve_takes_the_narrowest_corners_that_it_can_do_the_rest_with(needed, found):
    assert narrowest(lambda width: (needed / width) ** 2 - 1.0, 0.5, 1.0) == found


def test_what_width_does_not_mend_is_no_corner():
    assert narrowest(lambda width: 7.0 + 0.1 / width, 0.5, 1.0) == 0.5


@pytest.mark.parametrize(
    ("excess", "corners"),
    [
        (lambda width: (100.0 / width) ** 2 - 1.0, 128.0),
        # Of a joint whose stiffness has no corner.
        (lambda width: 0.4, 4.0),
        (lambda width: 0.4 - 1e-3 * width, 4.0),
    ],
)
def test_corners_that_are_passed_too_fast_get_wider_and_no_others(monkeypatch, excess, corners):
    outcome = SimpleNamespace(smoothing=SimpleNamespace(lead=4.0))

    def motors(run, outcome, share, *, sagged):
        return share * outcome.smoothing.lead

    def drives(problem, width):
        return [SimpleNamespace(value=-0.1), SimpleNamespace(value=excess(width))]

    monkeypatch.setattr(refinement, "motors_of", motors)
    monkeypatch.setattr(refinement, "drive_violations", drives)
    assert refinement._passable(SimpleNamespace(problem=None), outcome) == corners
