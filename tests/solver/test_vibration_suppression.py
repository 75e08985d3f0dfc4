"""Residual vibration suppression of motors with a wide smoothing of their law."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from small_arms import CONSTANT, joint, problem_text, reducer, write_robot

from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command import motor_change
from stiffopt.command.simulation import elastic_arm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.errors import NotSimulatedError
from stiffopt.problem.files import load_problem
from stiffopt.solver import arrival, vibration_suppression
from stiffopt.solver.solve import solve_with_state

SOFT = reducer(k1=100.0, k2=300.0, k3=500.0, t1=0.3, t2=0.9)
SOFTER = reducer(k1=400.0, k2=4e3, k3=6e3, t1=1.5, t2=9.0)
ARMS = {
    "swivel": ([joint("swivel", SOFT, jerk_max=1500.0)], "0.45"),
    "planar": ([joint(name, SOFTER, jerk_max=250.0) for name in ("shoulder", "elbow")], "0.8"),
    "half rigid": ([joint("shoulder", ""), joint("elbow", SOFTER, jerk_max=500.0)], "0.6"),
}


@pytest.fixture(scope="module", params=ARMS)
def solved(request, tmp_path_factory):
    """A problem, its outcome without the change, and with it."""
    folder = tmp_path_factory.mktemp(request.param)
    joints, duration = ARMS[request.param]
    arm = request.param if request.param == "swivel" else "planar"
    write_robot(folder, arm, joints)
    path = folder / "problem.toml"
    goal = {"duration": duration, "minimise": 'objective = "tool_deviation"'}
    path.write_text(problem_text(arm, **goal))
    problem = load_problem(path).problem
    with pytest.MonkeyPatch.context() as plain:
        plain.setattr(arrival, "suppress_vibration", refused)
        before, (_, outcome) = solve_with_state(problem)
        # The plan itself stays.
        plain.setattr(arrival, "_MAX_PLAN_DEVIATION", np.inf)
        plain.setattr(arrival, "suppress_vibration", vibration_suppression.suppress_vibration)
        after, _ = solve_with_state(problem)
    assert outcome.smoothing.lead > 1.0
    return problem, before, after


def solve_run(problem=None):
    return SimpleNamespace(
        problem=problem,
        step="",
        exchanges=[],
        homotopy=[],
        left_out=[],
        iterations=0,
        is_over=False,
    )


def refused(*_):
    raise NotSimulatedError("too fast")


def swing(problem, solution):
    motion = solution.assessment
    arm = elastic_arm(problem, motion.position[0])
    return simulate(arm, MotorMotion(motion.time, motion.position, motion.velocity))


def test_links_are_nearer_to_their_plan_and_every_limit_holds(solved):
    problem, before, after = solved
    assert after.status is before.status
    assert after.status.usable
    assert after.assessment.feasible(CERTIFICATE_TOLERANCE)
    # The plan of the links is the same.
    assert after.objective.value == pytest.approx(before.objective.value, rel=1e-9)
    plain, found, planned = swing(problem, before), swing(problem, after), after.objective.value
    # To a third, or within the target deviation.
    assert found.peak_after < max(0.3 * plain.peak_after, 0.04 * planned)
    assert abs(found.peak - planned) <= abs(plain.peak - planned)


def test_plan_at_jerk_limit_is_backed_off_for_vibration_suppression(tmp_path):
    joints, duration = ARMS["swivel"]
    write_robot(tmp_path, "swivel", joints)
    path = tmp_path / "problem.toml"
    goal = {"duration": duration, "minimise": 'objective = "tool_deviation"'}
    path.write_text(problem_text("swivel", **goal))
    problem = load_problem(path).problem
    with pytest.MonkeyPatch.context() as plain:
        plain.setattr(arrival, "_MAX_PLAN_DEVIATION", np.inf)
        before, _ = solve_with_state(problem)
    after, _ = solve_with_state(problem)
    assert after.status.usable
    assert after.assessment.feasible(CERTIFICATE_TOLERANCE)
    least, planned = before.objective.value, after.objective.value
    assert planned > least
    plain, found = swing(problem, before), swing(problem, after)
    # Without it, the tool leaves its plan by more than a tenth.
    assert plain.peak > 1.1 * least
    assert found.peak < 1.05 * planned
    assert found.peak + found.peak_after < plain.peak + plain.peak_after


def test_vibration_is_suppressed_with_constant_springs(tmp_path, monkeypatch):
    """Its sag changes with the pose, which motors of the plan leave out."""
    springs = zip(("shoulder", "elbow"), (500.0, 250.0), strict=True)
    arm = [joint(n, CONSTANT.format(stiffness=k), jerk_max=400.0) for n, k in springs]
    write_robot(tmp_path, "planar", arm)
    path = tmp_path / "problem.toml"
    goal = {"duration": "0.9", "minimise": 'objective = "tool_deviation"'}
    path.write_text(problem_text("planar", **goal))
    problem = load_problem(path).problem
    # Motors of the sag would exceed a limit.
    monkeypatch.setattr(arrival, "_sharpen_motor_law", lambda _, outcome: outcome)
    after, (_, outcome) = solve_with_state(problem)
    monkeypatch.setattr(arrival, "suppress_vibration", refused)
    before, _ = solve_with_state(problem)
    assert outcome.smoothing.lead == 1.0
    assert after.assessment.feasible(CERTIFICATE_TOLERANCE)
    plain, found = swing(problem, before), swing(problem, after)
    assert plain.peak_after > 5e-5
    assert found.peak_after < 0.3 * plain.peak_after


def test_change_keeps_position_to_jerk_at_ends(solved):
    _, before, after = solved
    for order in range(4):
        ends = [
            each.trajectory(np.array([0.0, each.trajectory.duration]), order)
            for each in (before, after)
        ]
        scale = np.max(np.abs(before.trajectory(before.assessment.time, order)))
        np.testing.assert_allclose(ends[1], ends[0], atol=1e-6 * scale)
    assert after.trajectory.link is not None


def test_motors_within_target_deviation_are_unchanged(solved, monkeypatch):
    problem, _, after = solved
    arm = elastic_arm(problem, after.assessment.position[0])
    monkeypatch.setattr(vibration_suppression, "_TARGET_DEVIATION", 1.0)
    start = vibration_suppression.SimulatedMotors.of(arm, after.trajectory, after.assessment)
    motors = vibration_suppression.suppress_vibration(
        solve_run(problem), arm, start, CERTIFICATE_TOLERANCE
    ).motors
    assert motors is after.trajectory


def test_second_change_follows_a_worse_first_one(monkeypatch):
    away = iter([0.5, 0.6, 0.1, 0.095, 0.0])

    class Judged:
        planned, motors, led, assessment, simulated = 1.0, None, None, None, None

        def __init__(self, *_):
            self.off, self.assessment = next(away), self

        def overshoot(self, _):
            return 0.0

        def feasible(self, _):
            return True

    monkeypatch.setattr(vibration_suppression, "assess", lambda *_, **__: None)
    monkeypatch.setattr(vibration_suppression.SimulatedMotors, "of", Judged)
    monkeypatch.setattr(vibration_suppression, "change_motors", lambda *_: None)
    # Past a kink the response is not linear; later changes without gain end it.
    assert (
        vibration_suppression.suppress_vibration(
            solve_run(), None, Judged(), CERTIFICATE_TOLERANCE
        ).off
        == 0.095
    )


def test_changes_continue_while_a_limit_after_arrival_is_exceeded(monkeypatch):
    away, given = iter([(0.02, 3.0), (0.015, 1.0), (0.01, 0.0)]), []

    class Judged:
        planned, motors, led, simulated = 1.0, None, None, None

        def __init__(self, *_):
            self.off, self.excess = next(away)
            self.assessment = self

        def overshoot(self, _):
            return self.excess

        def feasible(self, _):
            return self.excess <= 0.0

    monkeypatch.setattr(vibration_suppression, "assess", lambda *_, **__: None)
    monkeypatch.setattr(vibration_suppression.SimulatedMotors, "of", Judged)
    monkeypatch.setattr(
        vibration_suppression, "change_motors", lambda *asked: given.append(asked[-2:])
    )
    assert (
        vibration_suppression.suppress_vibration(
            solve_run(), None, Judged(), CERTIFICATE_TOLERANCE
        ).off
        == 0.01
    )
    # By how much it is exceeded, the change is to be nearer, and after arrival the more.
    near = vibration_suppression._TARGET_DEVIATION
    np.testing.assert_allclose(given, [(near / 4.0, 4.0), (near / 2.0, 8.0)])


def test_limit_after_arrival_gets_twice_as_many_changes(monkeypatch):
    # Nearer and further by turns, until it holds.
    away, made = iter([0.2, 0.15, 0.16, 0.14, 0.15, 0.12, 0.05]), []

    class Judged:
        planned, motors, led, simulated = 1.0, None, None, None

        def __init__(self, *_):
            self.off = next(away)
            self.assessment = self

        def overshoot(self, _):
            return 0.5

        def feasible(self, _):
            return self.off < 0.1

    monkeypatch.setattr(vibration_suppression, "assess", lambda *_, **__: None)
    monkeypatch.setattr(vibration_suppression.SimulatedMotors, "of", Judged)
    monkeypatch.setattr(vibration_suppression, "change_motors", lambda *_: made.append(1))
    assert (
        vibration_suppression.suppress_vibration(
            solve_run(), None, Judged(), CERTIFICATE_TOLERANCE
        ).off
        == 0.05
    )
    assert len(made) == 6


def test_nearly_used_limit_allows_no_change():
    used = np.array([0.0, 0.5, 1.0 - 0.5 * motor_change._LIMIT_RESERVE, 1.003])
    room = motor_change._remaining_limit(used)
    np.testing.assert_allclose(room[:2], 1.0 - used[:2] - motor_change._LIMIT_RESERVE)
    # One that is exceeded has to give way.
    np.testing.assert_allclose(room[2:], [0.0, -0.003], atol=1e-12)


def test_rigid_joints_are_unchanged(solved):
    problem, before, after = solved
    times = np.linspace(0.0, after.trajectory.duration, 501)
    moved = np.max(np.abs(after.trajectory(times) - before.trajectory(times)), axis=0)
    rigid = [chain is None or not chain.stages for chain in problem.robot.chains]
    np.testing.assert_array_equal(moved < 1e-12, rigid)


def test_an_arm_that_cannot_be_simulated_keeps_its_motors(solved, monkeypatch):
    problem, before, _ = solved

    monkeypatch.setattr(arrival, "suppress_vibration", refused)
    found, _ = solve_with_state(problem)
    assert found.objective.value == before.objective.value
    np.testing.assert_array_equal(found.assessment.position, before.assessment.position)


def test_minimum_duration_reserves_drives_for_vibration_suppression(tmp_path):
    write_robot(tmp_path, "planar", ARMS["planar"][0])
    path = tmp_path / "problem.toml"
    goal = {
        "duration": '{ lower = "0.3 s", upper = "3 s" }',
        "minimise": 'objective = "duration"',
        "limits": 'settling_time = "40 ms"\nsettling_band = "20 um"',
    }
    path.write_text(problem_text("planar", **goal))
    problem = load_problem(path).problem
    solution, _ = solve_with_state(problem, compare=False)
    assert solution.status.usable
    found = swing(problem, solution)
    late = found.time > solution.trajectory.duration + 0.04
    assert np.linalg.norm(found.deviation[late], axis=1).max() < 20e-6


def test_quadratic_programme_with_flat_hessian_is_solved():
    # A small vibration costs little beside the deviation in flight.
    rng = np.random.default_rng(4)
    turned, _ = np.linalg.qr(rng.normal(size=(60, 60)))
    hessian = turned * np.logspace(-3, 4, 60) @ turned.T
    wanted = rng.normal(size=60)
    rows = csc_matrix(rng.normal(size=(300, 60)))
    # Bounds that nothing reaches, and one that is.
    most = np.full(300, 1e2)
    found = motor_change._solve_quadratic_programme(hessian, -hessian @ wanted, rows, -most, most)
    assert found == pytest.approx(wanted, abs=1e-3)
    # Where a row cannot give way it gets no worse.
    rows, most = csc_matrix(np.eye(60)[[0, 0]]), np.array([1e2, -1.0])
    stays = motor_change._solve_quadratic_programme(
        hessian, -hessian @ wanted, rows, np.array([0.0, -1e2]), most
    )
    assert stays[0] == pytest.approx(0.0, abs=1e-6)
    assert np.abs(stays).max() > 0.1
