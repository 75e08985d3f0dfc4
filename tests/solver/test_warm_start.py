"""Solves that start from the motion of an earlier one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_arms import write_problem

from stiffopt.certificate.assess import assess
from stiffopt.cli import run
from stiffopt.errors import ProblemError
from stiffopt.problem.files import load_problem
from stiffopt.recipe.stored_result import read_guess
from stiffopt.result.store import export_times, write_trajectory
from stiffopt.solver.solve import solve


@pytest.fixture(scope="module")
def cold(tmp_path_factory):
    """Folder of a problem with its trajectory.csv, and the solution."""
    folder = tmp_path_factory.mktemp("warm")
    problem = load_problem(
        write_problem(folder, minimise='objective = "dynamic_deflection"')
    ).problem
    solution = solve(problem)
    times = export_times(solution.trajectory.duration)
    write_trajectory(assess(problem, solution.trajectory, times=times), folder)
    return folder, problem, solution


def test_guess_of_a_folder_is_its_motion(cold):
    folder, problem, solution = cold
    guess = read_guess(folder, problem)
    assert guess.duration == pytest.approx(solution.guess.duration)
    found = solution.guess.deflection_summary()["dynamic"]
    # Accelerations between the rows are those of cubic polynomials.
    assert guess.deflection_summary()["dynamic"].rms == pytest.approx(found.rms, rel=0.02)


def test_a_warm_start_ends_at_the_same_motion(cold):
    folder, problem, solution = cold
    again = solve(problem, guess=read_guess(folder, problem))
    assert again.objective.value == pytest.approx(solution.objective.value, rel=1e-3)


def test_the_guess_of_a_solution(cold):
    _, problem, solution = cold
    assert np.array_equal(solution.guess.position, solution.assessment.position)
    slower = replace(problem, duration=tuple(1.2 * d for d in problem.duration))
    assert solve(slower, guess=solution.guess).status.usable
    with pytest.raises(ValueError, match="no motion was found"):
        _ = replace(solution, assessment=None).guess
    fewer = replace(solution.guess, position=solution.guess.position[:, :1])
    with pytest.raises(ProblemError, match="the guess has 1 joints"):
        solve(problem, guess=fewer)


def test_folder_without_motion_is_refused(cold, tmp_path, capsys):
    arguments = ["solve", str(cold[0] / "problem.toml"), "--guess", str(tmp_path)]
    assert run([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert "trajectory.csv" in capsys.readouterr().err
