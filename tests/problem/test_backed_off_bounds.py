"""Bounds of states while limits are backed off."""

import numpy as np
import pytest
from small_arms import load

from stiffopt.problem.formulation import formulate
from stiffopt.problem.limit import derivative_bounds
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve


@pytest.mark.parametrize("margin", [0.05, 0.5, 0.95])
def test_a_backed_off_range_keeps_a_width(tmp_path, margin):
    problem = load(tmp_path)
    lower, upper = derivative_bounds(problem.active_limits, 0, {"position": margin})
    whole = problem.active_limits.position_upper - problem.active_limits.position_lower
    assert np.all(upper - lower > 0.0)
    np.testing.assert_allclose(upper - lower, whole * (1 - 2 * margin / (1 + margin)))


def test_backed_off_bounds_hold_start_and_end(tmp_path):
    """Within 0.05 rad of the end of the range, which a margin of 5 % of 6 rad would exclude."""
    problem = load(tmp_path, start="{ joints = [-2.95, 0.4] }", end="{ joints = [0.5, 2.95] }")
    motion, margins = resolve(problem), {"position": 0.05, "velocity": 0.05}
    whole, near = (formulate(problem, motion, Scales(), margins=each) for each in ({}, margins))
    for state in (np.append(motion.start, [0, 0]), np.append(motion.end, [0, 0])):
        assert np.all((near.state_lower <= state) & (state <= near.state_upper))
    np.testing.assert_allclose(near.state_lower[:2], [-2.95, -3 + 6 * 0.05 / 1.05])
    np.testing.assert_allclose(near.state_upper[:2], [3 - 6 * 0.05 / 1.05, 2.95])
    # Of the whole range otherwise, and never beyond it.
    np.testing.assert_allclose([whole.state_lower[:2], whole.state_upper[:2]], [[-3] * 2, [3] * 2])
