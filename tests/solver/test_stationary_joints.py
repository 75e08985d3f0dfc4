"""Creeping joints are fixed where dry friction is part of the objective."""

import numpy as np
import pytest
from small_arms import joint, load, reducer, write_problem, write_robot

from stiffopt.problem.files import load_problem
from stiffopt.result.status import SolveStatus
from stiffopt.solver import refinement
from stiffopt.solver.solve import solve

# Nearly hanging: the holding torque is less than the friction.
PIECES = {
    "start": "{ joints = [1.5, 0.0] }",
    "end": "{ joints = [1.6, 0.2] }",
    "duration": "1.0",
    "method": "intervals = 20",
}


@pytest.fixture
def creeping(tmp_path, monkeypatch):
    """An arm with dry friction, on one mesh."""
    monkeypatch.setattr(refinement, "_MAX_REFINEMENTS", 0)
    path = write_problem(tmp_path, "planar", **PIECES)
    joints = [joint(name, reducer(), coulomb=3.0) for name in ("shoulder", "elbow")]
    write_robot(tmp_path, "planar", joints)
    return load_problem(path).problem


def test_creeping_joints_are_fixed(creeping, monkeypatch):
    found = solve(creeping, throw=False)
    monkeypatch.setattr(refinement, "_MAX_STATIONARY_SOLVES", 0)
    before = solve(creeping, throw=False)
    rests = [np.mean(np.abs(s.assessment.velocity) < 1e-9, axis=0) for s in (before, found)]
    # By the sharp law of the certificate: creeping was charged three quarters more than believed.
    assert found.objective.value < 0.4 * before.objective.value
    assert np.max(rests[0]) < 0.01
    assert np.min(rests[1]) > 0.3
    assert found.assessment.feasible(5e-3)
    # The remaining gap is attributed to friction, not to the mesh.
    assert "joints creep" in before.message
    assert "between the nodes" not in before.message


def test_arms_without_friction_are_unchanged(tmp_path, monkeypatch):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr(refinement, "_CREEP_OBJECTIVE_GAP", -1.0)
    monkeypatch.setattr(refinement, "solve_again", never)
    assert solve(load(tmp_path, **PIECES), throw=False).status is SolveStatus.OPTIMAL


def test_ctrl_c_keeps_the_motion(creeping, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(refinement, "solve_again", interrupted)
    found = solve(creeping, throw=False)
    assert found.status is SolveStatus.INTERRUPTED
    assert found.assessment.feasible(5e-3)
