"""Optima of textbook problems of mechanisms by all three transcriptions."""

import pytest
from textbook import CASES

from stiffopt.solver.ipopt import IpoptOptions, IpoptSolver
from stiffopt.transcription import transcribe, uniform_mesh


def optimum(name: str, method: str, intervals: int) -> float:
    case = CASES[name]
    made = transcribe(case.ocp, method, uniform_mesh(intervals))
    found = IpoptSolver(made.nlp, IpoptOptions(tol=1e-10, max_iterations=2000)).solve(
        made.pack(case.guess)
    )
    assert found.converged, found.reason
    assert found.violation < 1e-7
    return found.objective


@pytest.mark.parametrize(
    ("method", "name", "intervals", "tolerance"),
    [
        ("radau", "block_move", 20, 1e-8),
        ("radau", "minimum_time", 20, 1e-7),
        ("radau", "bryson_denham", 20, 5e-4),
        ("radau", "bryson_denham", 80, 1e-5),
        ("radau", "robot_arm", 20, 3e-4),
        ("radau", "robot_arm", 80, 3e-4),
        ("radau", "cart_pole", 40, 1e-3),
        ("radau", "cart_pole", 80, 1e-5),
        ("radau", "two_link_arm", 20, 1e-3),
        ("radau", "two_link_arm", 80, 1e-4),
        # A continuous control needs an interval to switch: bang-bang optima have order 2.
        ("hermite_simpson", "block_move", 20, 1e-8),
        ("hermite_simpson", "minimum_time", 80, 2e-4),
        ("hermite_simpson", "bryson_denham", 40, 1e-4),
        ("hermite_simpson", "robot_arm", 40, 3e-4),
        ("hermite_simpson", "cart_pole", 80, 1e-3),
        ("hermite_simpson", "two_link_arm", 80, 2e-4),
    ],
)
def test_schemes_reach_the_reference(method, name, intervals, tolerance):
    expected = CASES[name].reference
    assert optimum(name, method, intervals) == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize(
    "name", ["block_move", "minimum_time", "bryson_denham", "robot_arm", "two_link_arm"]
)
def test_piecewise_linear_is_within_its_order(name):
    coarse, fine = (
        optimum(name, "piecewise_linear_acceleration", count) - CASES[name].reference
        for count in (20, 80)
    )
    assert coarse / fine == pytest.approx(16.0, rel=0.15)
