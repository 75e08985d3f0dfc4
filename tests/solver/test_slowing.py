"""Slowing of a motion that no correction brought within its limits."""

from dataclasses import replace

import pytest
from small_arms import joint, problem_text, reducer, write_robot

from stiffopt.certificate.assess import assess
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.files import load_problem
from stiffopt.problem.objective import Objective
from stiffopt.result.status import SolveStatus
from stiffopt.solver.exchange import exchange
from stiffopt.solver.slowing import Slowing
from stiffopt.solver.solve import solution_of, solve_with_state


@pytest.fixture(scope="module")
def hurried(tmp_path_factory):
    """Run and outcome of a motion that ended before its optimum, a tenth of it too fast."""
    folder = tmp_path_factory.mktemp("hurried")
    write_robot(folder, "swivel", [joint("swivel", reducer(), jerk_max=400.0)])
    path = folder / "problem.toml"
    path.write_text(problem_text("swivel", duration='{ upper = "2 s" }',
                                 minimise='objective = "duration"'))  # fmt: skip
    _, (run, found) = solve_with_state(load_problem(path).problem)
    fast = found.planned.scaled_to(0.9 * found.planned.duration)
    return run, replace(found, planned=fast, trajectory=fast, assessment=assess(run.problem, fast),
                        raw=replace(found.raw, status="iteration_limit"))  # fmt: skip


def test_motion_is_slowed_by_the_least_share_that_keeps_every_limit(hurried):
    run, fast = hurried
    found = exchange(run, Slowing(run), fast)
    assert found.assessment.feasible(CERTIFICATE_TOLERANCE)
    # The optimum is at its limits: the motion sped up by 1/0.9 has to be slowed by as much.
    slowing = found.assessment.duration / fast.assessment.duration
    assert slowing == pytest.approx(1.0 / 0.9, abs=4e-3)
    judged = solution_of(run, found, {}, (), compare=False)
    assert judged.status is SolveStatus.ACCEPTABLE
    assert any("slowed by 11 % along its path" in note for note in judged.notes)


def test_motion_of_a_given_duration_is_left(hurried):
    run, fast = hurried
    fixed = {
        "duration": (fast.planned.duration,) * 2,
        "objectives": (Objective(name="torque_squared"),),
    }
    given = replace(run, problem=replace(run.problem, **fixed))
    assert Slowing(given).propose(fast, 0) is None
    kept = replace(fast, assessment=exchange(run, Slowing(run), fast).assessment)
    assert Slowing(run).propose(kept, 0) is None
