"""Meshes: splitting, checks, and refinement towards activity."""

import numpy as np
import pytest
from textbook import minimum_time

from stiffopt.errors import ProblemError
from stiffopt.solver.ipopt import IpoptSolver
from stiffopt.transcription import refine_mesh, transcribe, uniform_mesh
from stiffopt.transcription.mesh import split_counts


def test_uniform_mesh_splits_by_shares():
    mesh = uniform_mesh(10, 3, shares=[1, 3, 1])
    assert [len(part) for part in mesh] == [2, 6, 2]
    assert all(part.sum() == pytest.approx(1.0) for part in mesh)


@pytest.mark.parametrize("total", [3, 7, 40, 41])
def test_counts_are_whole_and_complete(total):
    counts = split_counts(total, np.array([1e-3, 0.5, 2.0]))
    assert counts.sum() == total
    assert counts.min() >= 1


def test_fewer_intervals_than_phases_are_refused():
    with pytest.raises(ProblemError, match="2 intervals cannot cover 3 phases"):
        uniform_mesh(2, 3)


def test_refinement_finds_the_switch():
    """An odd uniform mesh misses the switch at half time; refinement shortens intervals there."""
    case = minimum_time()
    made = transcribe(case.ocp, "piecewise_linear_acceleration", uniform_mesh(15))
    found = IpoptSolver(made.nlp).solve(made.pack(case.guess))
    mesh = refine_mesh(made, found.x, 15)
    finer = transcribe(case.ocp, "piecewise_linear_acceleration", mesh)
    again = IpoptSolver(finer.nlp).solve(finer.pack(made.guess_from(found.x)))
    assert mesh[0][7] < 0.5 / 15
    assert again.objective - 2.0 < 0.3 * (found.objective - 2.0)
