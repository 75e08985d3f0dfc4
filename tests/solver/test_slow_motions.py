"""Motions slow beside the drive limits: scaling, sufficient objective."""

import numpy as np
import pytest
from small_arms import ROOT

from stiffopt.problem.coordinates import coordinates_of
from stiffopt.problem.files import load_problem
from stiffopt.problem.objective import OBJECTIVES
from stiffopt.result.status import SolveStatus
from stiffopt.solver.solve import solve


def slow(name, seconds):
    return load_problem(ROOT / "problems" / f"{name}.toml", (f"motion.duration={seconds}",)).problem


@pytest.mark.parametrize("name", ["er3a_pick_and_place", "er3a_tool_deviation"])
def test_states_of_slow_motions_are_scaled_by_their_duration(name):
    one, other = (coordinates_of(slow(name, seconds)) for seconds in (20.0, 40.0))
    for k in range(1, one.order):
        derivative = slice(k * one.size, (k + 1) * one.size)
        shrinks = one.state_scale[derivative] / other.state_scale[derivative]
        np.testing.assert_allclose(shrinks, 2.0**k)
    np.testing.assert_allclose(one.control_scale / other.control_scale, 2.0**one.order)


def test_fast_motions_are_scaled_by_the_limits():
    problem = slow("er3a_pick_and_place", 0.6)
    np.testing.assert_array_equal(
        coordinates_of(problem).control_scale, problem.active_limits.acceleration
    )


def test_sufficient_objective_value():
    moving = OBJECTIVES["tool_deviation"]
    assert moving.target_value(1e-3) == 5e-6
    assert moving.target_value(9e-6) == pytest.approx(3e-6)
    assert OBJECTIVES["total_deflection"].target_value(1e-3) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seconds"), [("er3a_pick_and_place", 10.0), ("ur10_tool_deviation", 12.0)]
)
def test_slow_motion_stops_at_sufficient_objective(name, seconds):
    found = solve(slow(name, seconds))
    assert found.status in (SolveStatus.OPTIMAL, SolveStatus.ACCEPTABLE)
    assert found.ratio_to_better_baseline < 0.5
    assert found.objective.value < 5.5e-6
    assert any("and no further" in note for note in found.notes)
