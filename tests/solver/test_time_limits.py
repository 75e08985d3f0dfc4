"""Time limits: less time gives the same answer, or one whose status says what was left out."""

import time
from dataclasses import replace

import pytest
from small_arms import ROOT

from stiffopt.problem.files import load_problem
from stiffopt.result.status import SolveStatus
from stiffopt.solver.solve import solve

# The second has an [uncertainty] whose step an earlier clock dropped in silence.
SHIPPED = ("ur10_torque_squared", "ur10_uncertain_deviation", "er3a_pick_and_place", "two_link")


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_less_time_gives_the_same_answer_or_names_what_was_left_out(name):
    problem = load_problem(ROOT / "problems" / f"{name}.toml").problem
    begin = time.perf_counter()
    whole = solve(problem)
    seconds = time.perf_counter() - begin
    assert whole.status.usable
    assert not whole.solver.left_out
    for factor in (2, 4, 20):
        method = replace(problem.method, time_limit=seconds / factor)
        found = solve(replace(problem, method=method), throw=False)
        if found.solver.left_out or found.status is SolveStatus.TIME_LIMIT:
            assert found.status is not SolveStatus.OPTIMAL
            assert "time" in found.message
        else:
            assert found.status is whole.status
            assert found.objective.value == pytest.approx(whole.objective.value, rel=1e-9)
