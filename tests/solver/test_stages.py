"""How fine meshes are reached."""

from pathlib import Path

import pytest

from stiffopt.problem.files import load_problem
from stiffopt.solver.plan import stages

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"


@pytest.mark.parametrize(
    ("intervals", "expected"), [(60, [30, 40, 60]), (300, [60, 100, 300]), (20, [16, 16, 20])]
)
def test_first_meshes_of_a_peak_do_not_grow_with_the_last(intervals, expected):
    problem = load_problem(PROBLEMS / "ur10_dynamic_deflection.toml").problem
    assert [stage.intervals for stage in stages(problem, intervals)] == expected
