"""Advice on a feasible duration where no motion was found."""

import re
from dataclasses import replace

import pytest
from small_arms import joint, problem_text, reducer, write_robot

from stiffopt.problem.files import load_problem
from stiffopt.result.status import SolveStatus
from stiffopt.solver.solve import solution_of, solve, solve_with_state
from stiffopt.solver.trivial_outcomes import feasible_duration_advice

DEVIATION = 'objective = "tool_deviation"'


@pytest.fixture(scope="module")
def hurried(tmp_path_factory):
    """A motion of the shoulder in less than 0.431 s, which its jerk allows: (32 d / jerk)^(1/3)."""
    folder = tmp_path_factory.mktemp("hurried")
    joints = [joint("swivel", reducer(), jerk_max=400.0)]
    write_robot(folder, "swivel", joints)
    path = folder / "problem.toml"
    path.write_text(problem_text("swivel", duration="0.4", minimise=DEVIATION))
    return load_problem(path).problem


def test_advised_duration_is_feasible(hurried):
    found = solve(hurried, throw=False)
    assert found.status in (SolveStatus.INFEASIBLE, SolveStatus.CERTIFICATE_FAILED)
    named = re.search(r'motion\.duration = "([0-9.]+) s"', found.message)
    assert named is not None, found.message
    longer = float(named[1])
    assert 0.43 < longer < 0.9
    assert solve(replace(hurried, duration=(longer, longer)), throw=False).status.usable


def test_no_advice_for_free_duration(hurried):
    free = replace(hurried, duration=(0.4, 2.0))
    _, kept = solve_with_state(free)
    assert kept is not None
    assert feasible_duration_advice(*kept) == ""


def test_iteration_limit_gets_duration_advice(hurried):
    _, (run, outcome) = solve_with_state(hurried)
    met = replace(outcome, raw=replace(outcome.raw, status="iteration_limit"))
    found = solution_of(run, met, {}, ())
    assert found.status is SolveStatus.ITERATION_LIMIT
    assert "motion.duration = " in found.message
