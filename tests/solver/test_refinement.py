"""Refinement: back-off of rows between the nodes of the last mesh."""

from dataclasses import replace

import numpy as np
import pytest
from small_arms import ROOT, joint, load, problem_text, reducer, write_robot

from stiffopt.certificate.objective_value import objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.files import load_problem
from stiffopt.problem.objective import Objective
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.problem.trajectory import Method, Target, TrajectoryProblem
from stiffopt.result.status import SolveStatus
from stiffopt.robot.files import load_robot
from stiffopt.solver import exact_rows, refinement, starts
from stiffopt.solver.exact_rows import ExactRows
from stiffopt.solver.exchange import exchange
from stiffopt.solver.solve import solve, solve_with_state
from stiffopt.solver.stage_plan import plan_stages
from stiffopt.transcription.constraint_back_off import KnownRows, back_off_states, backed_off

NOISY_PATH = ROOT.parent / "shared" / "cases" / "planning" / "w04_noisy60.toml"
PEAK = 'objective = "dynamic_deflection"\nmeasure = "peak"'


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    folder = tmp_path_factory.mktemp("refined")
    return load(folder, duration="0.45", minimise=PEAK, method="intervals = 6")


@pytest.fixture
def coarse(monkeypatch):
    """The mesh stays, so that a peak between its nodes is left to the rows."""
    monkeypatch.setattr(refinement, "_MAX_FINER_MESHES", 0)
    monkeypatch.setattr(exact_rows, "MAX_OBJECTIVE_GAP", 0.004)


def left_alone(problem, monkeypatch):
    """The solution without corrections of the last mesh."""
    with monkeypatch.context() as plain:
        plain.setattr(exact_rows, "MAX_CORRECTIONS", 0)
        return solve(problem, throw=False)


def test_rough_last_stage_is_solved_to_the_end(problem, monkeypatch):
    problem = replace(problem, method=replace(problem.method, intervals=30))
    exact = solve(problem)
    assert exact.status is SolveStatus.OPTIMAL

    def roughly(*given):
        *first, last = plan_stages(*given)
        return (*first, replace(last, tolerance=1e-2))

    monkeypatch.setattr(starts, "plan_stages", roughly)
    rough = left_alone(problem, monkeypatch)
    assert rough.status is SolveStatus.ACCEPTABLE
    found = solve(problem)
    assert found.status is SolveStatus.OPTIMAL
    assert "constraint back-off" in {each["step"] for each in found.solver.exchanges}
    assert found.objective.value == pytest.approx(exact.objective.value, rel=1e-3)


def test_timed_out_correction_keeps_the_optimum(problem, coarse, monkeypatch):
    before = left_alone(problem, monkeypatch)
    assert before.status.usable
    plain, calls = exact_rows.solve_again, []

    def late(*given):
        calls.append(given)
        found = plain(*given)
        return replace(found, raw=replace(found.raw, status="time_limit"))

    monkeypatch.setattr(exact_rows, "solve_again", late)
    after = solve(problem, throw=False)
    assert calls
    assert after.status is before.status
    assert after.objective.value == before.objective.value


def test_ctrl_c_in_a_correction_is_reported(problem, coarse, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    before = left_alone(problem, monkeypatch)
    monkeypatch.setattr(exact_rows, "solve_again", interrupted)
    after = solve(problem, throw=False)
    assert after.status is SolveStatus.INTERRUPTED
    assert after.objective.value == before.objective.value


def test_correction_with_worse_objective_is_rejected(problem, coarse, monkeypatch):
    before = left_alone(problem, monkeypatch)
    plain, values = exact_rows.solve_again, []

    def nearer_but_worse(run, outcome, nlp, smoothing):
        worse = plain(run, outcome, outcome.nlp, Smoothing(64.0 * smoothing.stiffness))
        assert worse.raw.converged
        assert worse.assessment.feasible(CERTIFICATE_TOLERANCE)
        values.append(objective_value(run.problem, worse.assessment).value)
        return replace(worse, objective_gap=0.0)

    monkeypatch.setattr(exact_rows, "solve_again", nearer_but_worse)
    after = solve(problem, throw=False)
    assert values[0] > before.objective.value
    assert after.objective.value == before.objective.value


def test_nothing_is_solved_again_where_no_row_is_exceeded(problem, monkeypatch):
    def never(*_):
        raise AssertionError

    smooth = replace(problem, objectives=(Objective(name="torque_squared"),))
    _, kept = solve_with_state(smooth)
    run, outcome = kept
    monkeypatch.setattr(exact_rows, "solve_again", never)
    worse = replace(outcome, objective_gap=0.5)
    assert exchange(run, ExactRows(run), worse) is worse


def test_excess_hidden_by_smoothing_is_backed_off(tmp_path, coarse, monkeypatch):
    soft = reducer(k1=3e3, k2=9e3, k3=1.2e4)
    softer = reducer(k1=1e3, k2=3e3, k3=6e3, t1=1.0)
    write_robot(tmp_path, "planar", [joint("shoulder", soft), joint("elbow", softer)])
    path = tmp_path / "problem.toml"
    path.write_text(problem_text("planar", duration="0.8", minimise=PEAK, method="intervals = 16"))
    stated = load_problem(path).problem
    found, (_, outcome) = solve_with_state(stated)
    monkeypatch.setattr(exact_rows, "_CHECK_SMOOTHING_SHARE", 1.0)
    rounded, (_, before) = solve_with_state(stated)
    assert before.objective_gap > exact_rows.MAX_OBJECTIVE_GAP
    assert outcome.objective_gap < 0.3 * before.objective_gap
    assert found.objective.value < rounded.objective.value
    assert found.assessment.feasible(CERTIFICATE_TOLERANCE)


@pytest.mark.parametrize(("excess", "wider"), [(29.0, True), (0.5, False)])
def test_smoothing_widens_before_correcting_a_spike(tmp_path, monkeypatch, excess, wider):
    soft = joint("swivel", reducer(k1=100.0, k2=300.0, k3=500.0, t1=0.3, t2=0.9))
    write_robot(tmp_path, "swivel", [soft])
    path = tmp_path / "problem.toml"
    path.write_text(problem_text("swivel", duration="0.6", minimise='objective = "tool_deviation"'))
    _, (run, outcome) = solve_with_state(load_problem(path).problem)
    tried = []

    def never_solved(run, before, nlp, smoothing):
        tried.append(smoothing.lead)
        return replace(before, raw=replace(before.raw, status="iteration_limit"))

    monkeypatch.setattr(exact_rows, "excess_by_limit", lambda _: {"jerk": excess})
    monkeypatch.setattr(exact_rows, "solve_again", never_solved)
    assert exchange(run, ExactRows(run), outcome) is outcome
    before = outcome.smoothing.lead
    assert len(tried) == 1
    assert (tried[0] > 1.3 * before) == wider


def test_motors_beyond_their_range_move_the_links_bounds_there_alone(tmp_path):
    """Positions of links are rows at the nodes; motors that lead pass them, within a narrow box."""
    write_robot(tmp_path, "planar", [joint("shoulder", reducer()), joint("elbow", reducer())])
    path = tmp_path / "problem.toml"
    box = "position_lower = [-3.0, -3.0]\nposition_upper = [2.0, 3.0]"
    goal = 'objective = "tool_deviation"'
    path.write_text(problem_text("planar", duration="0.8", minimise=goal, limits=box))
    problem = load_problem(path).problem
    _, (_, outcome) = solve_with_state(problem)
    times = np.linspace(0.0, outcome.planned.duration, 2001)
    motors = outcome.planned(times)
    late = np.abs(times - 0.5) < 0.02
    motors[late, 0] = -3.1
    known = KnownRows(times, motors)
    closer = back_off_states(outcome.nlp, outcome.transcription, outcome.raw.x, known)
    assert np.array_equal(closer.upper_g, outcome.nlp.upper_g)
    moved = np.flatnonzero(closer.lower_g != outcome.nlp.lower_g)
    assert closer.lower_g[moved] == pytest.approx(-3.0 + 1.25 * 0.1)
    entries = [outcome.nlp.rows.entry(k) for k in moved]
    assert {each.label for each in entries} == {"position of link 1"}
    assert all(abs(0.8 * each.fraction - 0.5) < 0.1 for each in entries)


@pytest.mark.slow
def test_cycle_of_vias_whose_motors_pass_the_box_of_its_travel_is_optimal():
    """The box of joint 4 lies below zero: a back-off by shares of bounds made it wider."""
    random = np.random.default_rng(2)
    robot = load_robot("ur10").with_payload(3.0, [0.0, 0.0, 0.05], [4e-3] * 3)
    middle = np.array([0.0, -1.2, 1.4, -1.7, -1.5, 0.0])
    poses = [
        Target(joints=middle + random.uniform(-0.5, 0.5, 6), tolerance=5e-3) for _ in range(10)
    ]
    problem = TrajectoryProblem(
        robot=robot,
        start=Target(joints=poses[0].joints),
        vias=tuple(poses[1:-1]),
        end=Target(joints=poses[-1].joints),
        duration=(5.326, 5.326),
        objectives=(Objective(name="tool_error"),),
        method=Method(intervals=90),
    )
    found = solve(problem)
    assert found.status is SolveStatus.OPTIMAL
    assert any("position" in each["reason"] for each in found.solver.exchanges)


def test_via_is_met_despite_delayed_windup(tmp_path):
    # Much damping: motors lag behind by more than the via may be missed by.
    write_robot(
        tmp_path,
        "planar",
        [joint("shoulder", reducer(), damping=8.0), joint("elbow", reducer(), damping=8.0)],
    )
    path = tmp_path / "problem.toml"
    via = "via = [{ joints = [0.1, 0.7], tolerance = 1e-5 }]"
    goal = 'objective = "tool_deviation"'
    path.write_text(problem_text("planar", motion=via, duration="0.8", minimise=goal))
    found = solve(load_problem(path).problem, throw=False)
    assert found.status is SolveStatus.OPTIMAL, found.message


def test_a_limit_backed_off_again_and_again_stays_above_zero():
    margin = 0.0
    for excess in (1.65, 1.65, 30.0, 0.1):
        margin = backed_off(margin, excess)
        assert 0.0 < margin < 1.0
    # Half as much again of half a limit: a third of it.
    assert backed_off(0.5, 0.5) == pytest.approx(2.0 / 3.0)


@pytest.mark.slow
@pytest.mark.skipif(not NOISY_PATH.is_file(), reason="there is no ../shared/cases/planning")
def test_a_path_with_noise_has_an_answer():
    solution = solve(load_problem(NOISY_PATH).problem, throw=False)
    assert solution.status is SolveStatus.OPTIMAL
