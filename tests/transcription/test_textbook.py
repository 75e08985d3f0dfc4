"""Optima of the textbook problems by all three transcriptions."""

import pytest
from textbook import CASES

from stiffopt.solve.ipopt import IpoptSolver
from stiffopt.solve.options import IpoptOptions
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
