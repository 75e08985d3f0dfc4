"""Optima of the textbook problems by all three transcriptions."""

import pytest
from textbook import CASES

from stiffopt.errors import ProblemError
from stiffopt.solver.ipopt import IpoptOptions, IpoptSolver
from stiffopt.transcription import transcribe, uniform_mesh

# IPOPT cannot do better than 1e-8 on these (singular arc, free controls at the ends).
TOLERANCE = {"goddard": 1e-8, "robot_arm": 1e-8, "particle_steering": 1e-8}


def optimum(name: str, method: str, intervals: int, degree: int = 3) -> float:
    case = CASES[name]
    made = transcribe(case.ocp, method, uniform_mesh(intervals), degree=degree)
    options = IpoptOptions(tol=TOLERANCE.get(name, 1e-10), max_iterations=2000)
    found = IpoptSolver(made.nlp, options).solve(made.pack(case.guess))
    assert found.converged, found.reason
    assert found.violation < 1e-7
    return -found.objective if case.maximise else found.objective


def radau_runs():
    for name, case in CASES.items():
        for intervals, expected, tolerance in case.meshes:
            yield pytest.param(name, intervals, expected, tolerance, id=f"{name}-{intervals}")


@pytest.mark.parametrize(("name", "intervals", "expected", "tolerance"), list(radau_runs()))
def test_radau_of_degree_four(name, intervals, expected, tolerance):
    assert optimum(name, "radau", intervals, degree=4) == pytest.approx(expected, abs=tolerance)


# Errors at N = 20, 40, 80 fall with order 2 for the piecewise-linear control, order 4 for
# Hermite-Simpson on smooth problems; the tolerances are those of the order, from the value at 20.
@pytest.mark.parametrize(
    ("name", "intervals", "tolerance"),
    [
        ("block_move", 20, 1e-9),
        ("minimum_time", 20, 1e-7),
        ("bryson_denham", 40, 5e-5),
        ("brachistochrone_down", 20, 1e-7),
        ("brachistochrone_up", 40, 1e-6),
        ("van_der_pol_5", 80, 5e-5),
        ("goddard", 40, 1e-5),
        ("robot_arm", 40, 3e-4),
        ("particle_steering", 20, 1e-7),
        ("cart_pole", 40, 1e-3),
        ("two_link_arm", 80, 2e-4),
    ],
)
def test_hermite_simpson(name, intervals, tolerance):
    expected = CASES[name].reference
    assert optimum(name, "hermite_simpson", intervals) == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize("name", ["brachistochrone_down", "particle_steering", "two_link_arm"])
def test_piecewise_linear_is_within_its_order(name):
    coarse = optimum(name, "piecewise_linear", 20) - CASES[name].reference
    fine = optimum(name, "piecewise_linear", 80) - CASES[name].reference
    assert abs(fine) < 1e-3
    assert coarse / fine == pytest.approx(16.0, rel=0.15)


def test_unknown_method_is_refused():
    case = CASES["block_move"]
    with pytest.raises(ProblemError, match="Did you mean 'radau'"):
        transcribe(case.ocp, "radaw", uniform_mesh(10))
    with pytest.raises(ProblemError, match="allowed: 1 to 9"):
        transcribe(case.ocp, "radau", uniform_mesh(10), degree=0)
