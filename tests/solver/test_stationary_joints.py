"""Creeping joints are fixed where dry friction is part of the objective."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from small_arms import joint, load, reducer, write_problem, write_robot

from stiffopt.problem.files import load_problem
from stiffopt.problem.stage_model import StageModel
from stiffopt.problem.trajectory import Target
from stiffopt.result.status import SolveStatus
from stiffopt.robot.files import load_robot
from stiffopt.solver import exact_rows, refinement, stationary_joints
from stiffopt.solver.ipopt import IpoptSolver
from stiffopt.solver.solve import solve
from stiffopt.solver.stage_plan import plan_stages

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
    monkeypatch.setattr(refinement, "_MAX_FINER_MESHES", 0)
    path = write_problem(tmp_path, "planar", **PIECES)
    joints = [joint(name, reducer(), coulomb=3.0) for name in ("shoulder", "elbow")]
    write_robot(tmp_path, "planar", joints)
    return load_problem(path).problem


def test_creeping_joints_are_fixed(creeping, monkeypatch):
    # On 20 intervals rounding decides which joints rest, and gains between 7 and 37 %.
    creeping = replace(creeping, method=replace(creeping.method, intervals=40))
    found = solve(creeping, throw=False)
    monkeypatch.setattr(stationary_joints, "MANY_PHASES", 0)
    before = solve(creeping, throw=False)
    rests = [np.mean(np.abs(s.assessment.velocity) < 1e-9, axis=0) for s in (before, found)]
    # By the sharp law of the certificate; more on finer meshes, which are not allowed here.
    assert found.objective.value < 0.7 * before.objective.value
    assert np.max(rests[0]) < 0.01
    assert np.min(rests[1]) > 0.15
    assert found.assessment.feasible(5e-3)
    steps = [(each["step"], each["accepted"]) for each in found.solver.exchanges]
    assert ("joints at rest", True) in steps
    # The remaining gap is attributed to friction, not to the mesh.
    assert "joints creep" in found.message
    assert "between the nodes" not in found.message


def test_smooth_friction_does_not_hide_torque(creeping, monkeypatch):
    # With a third of the weight beyond the friction, no joint gains by creeping: the optimiser's
    # value is the certified one on the first mesh. On 20 or 40 intervals rounding decides between
    # this optimum and one that such a mesh shows 5 or 2 % too good.
    monkeypatch.setattr(stationary_joints, "MANY_PHASES", 0)
    creeping = replace(creeping, method=replace(creeping.method, intervals=80))
    heavy = replace(creeping, start=Target(joints=[0.3, 0.4]), end=Target(joints=[0.9, 0.14]))
    found = solve(heavy, throw=False)
    believed = found.solver.homotopy[-1]["objective"]
    assert found.status is SolveStatus.OPTIMAL
    assert found.objective.value == pytest.approx(believed, rel=0.02)


def test_dry_friction_is_charged_in_full_at_rest_unless_joints_may_creep():
    robot = load_robot("er3a_c60")
    n = robot.n
    p, v, rest = ca.SX.sym("p", n), ca.SX.sym("v", n), ca.SX.zeros(n)
    for creeping, share in ((0.0, 1.0), (1.0, 0.0)):
        model = StageModel(robot, p, v, rest, np.zeros(3), 1.0, np.zeros(n), (1.0, creeping, 0.0))
        beside = model.squared_drive_torque - model.torques.spring**2
        charged = ca.Function("charged", [p, v], [beside])(np.full(n, 0.4), 0.0)
        np.testing.assert_allclose(np.ravel(charged), share * robot.coulomb**2, atol=1e-9)


def test_arms_without_friction_are_unchanged(tmp_path, monkeypatch):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr(exact_rows, "solve_again", never)
    monkeypatch.setattr(stationary_joints, "solve_again", never)
    assert solve(load(tmp_path, **PIECES), throw=False).status is SolveStatus.OPTIMAL


def test_steps_that_the_time_limit_ended_are_named(creeping, monkeypatch):
    plain, made = IpoptSolver.solve, []

    def slow(*given, **options):
        made.append(plain(*given, **options))
        # The stages of the optimum are in time, what follows them is not.
        late = len(made) > len(plan_stages(creeping, 20))
        return replace(made[-1], status="time_limit") if late else made[-1]

    monkeypatch.setattr(IpoptSolver, "solve", slow)
    found = solve(creeping, throw=False)
    assert found.status is SolveStatus.ACCEPTABLE
    assert found.solver.left_out[0] == "joints at rest"
    assert "the time limit ended or left out: joints at rest" in found.message
    assert "raise method.time_limit" in found.message


def test_ctrl_c_keeps_the_motion(creeping, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(stationary_joints, "solve_again", interrupted)
    found = solve(creeping, throw=False)
    assert found.status is SolveStatus.INTERRUPTED
    assert found.assessment.feasible(5e-3)
