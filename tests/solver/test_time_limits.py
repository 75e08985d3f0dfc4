"""Time limits: less time gives the same answer, or one whose status says what was left out."""

import time
from dataclasses import replace

import pytest
from small_arms import ROOT, load

from stiffopt.problem.files import load_problem
from stiffopt.result.status import SolveStatus
from stiffopt.solver.solve import solve

# The second has an [uncertainty] whose step an earlier clock dropped in silence.
SHIPPED = ("ur10_torque_squared", "ur10_uncertain_deviation", "er3a_pick_and_place", "two_link")


def test_waiting_for_the_processor_leaves_out_no_step(tmp_path):
    problem = load(tmp_path, minimise='objective = "torque_squared"', method="intervals = 12")
    begin = time.thread_time()
    whole = solve(problem)
    limit = 2.0 * (time.thread_time() - begin)
    waits = iter([limit])

    def wait(_):
        time.sleep(next(waits, 0.0))

    method = replace(problem.method, time_limit=limit)
    found = solve(replace(problem, method=method), progress=wait)
    assert not found.solver.left_out
    assert found.status is whole.status


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_less_time_gives_the_same_answer_or_names_what_was_left_out(name):
    problem = load_problem(ROOT / "problems" / f"{name}.toml").problem
    begin = time.thread_time()
    whole = solve(problem)
    seconds = time.thread_time() - begin
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
