"""Widths of the motors' law at the corners of a joint's stiffness."""

import pytest

from stiffopt.solver.corners import widened


@pytest.mark.parametrize("needed", [0.25, 1.7, 4.0])
def test_corners_are_as_wide_as_the_jerk_needs(needed):
    # Jerk goes with one over the square of the width; a width stands for the motion here.
    def excess(width):
        return (needed / width) ** 2 - 1.0

    found = widened(lambda width: width, excess, 0.25, 0.0)
    assert needed <= found < 2.0 * needed


def test_what_no_width_mends_stays_narrow():
    assert widened(lambda width: width, lambda width: 3.0, 0.25, 0.0) == 0.25
