"""Feedforward lead of the motors: derivatives, export, back-off and elastic simulation."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from small_arms import load

from stiffopt.baseline.baselines import baselines
from stiffopt.certificate.assess import assess
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.errors import InputError
from stiffopt.problem.formulation import exact_path_rows, formulate
from stiffopt.problem.motor_model import (
    LAW_SMOOTHING_FACTOR,
    ApproximateMotorModel,
    MotorLaw,
    MotorModel,
    round_lags,
)
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.problem.trajectory import Method
from stiffopt.result.store import export_times, write_trajectory
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.initial_guess import initial_guess
from stiffopt.solver.solve import solve
from stiffopt.transcription import constraint_back_off
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.constraint_back_off import (
    Excess,
    KnownRows,
    back_off_exceeded,
    path_row_excess,
)
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.point_function import PointFunction

GOAL = 'objective = "tool_deviation"'
SMOOTHING = 0.25


def smooth_link(start, end, duration):
    """From rest to rest in every derivative up to the fifth: degree 11."""
    # The velocity is 2772 times s^5 (1 - s)^5.
    speed = 2772.0 * Polynomial([0, 1]) ** 5 * Polynomial([1, -1]) ** 5
    second = speed.deriv().coef / duration ** (2.0 + np.arange(10))
    change = np.asarray(end) - np.asarray(start)
    acceleration = second[None, :, None] * change
    return Trajectory([0.0, duration], acceleration, start, np.zeros(len(change)))


@pytest.fixture(scope="module")
def planar(tmp_path_factory):
    return load(tmp_path_factory.mktemp("arm"), minimise=GOAL)


@pytest.fixture(scope="module")
def link():
    return smooth_link([0.2, 0.5], [1.1, -0.2], 0.7)


def rates(model):
    return [model.position, model.velocity, model.acceleration, model.jerk]


def models(robot, force=(0.0, 0.0, 0.0)):
    """Functions of the motors' position to jerk: exact, and as the optimiser sees them."""
    symbols = [ca.SX.sym(f"d{k}", robot.n) for k in range(6)]
    given = (robot, symbols, SMOOTHING, np.zeros(robot.n), force)
    return [
        ca.Function("law", symbols, rates(kind(*given)))
        for kind in (MotorModel, ApproximateMotorModel)
    ]


@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (20.0, -10.0, -60.0)])
def test_motor_derivatives_equal_differences_of_the_position(planar, link, force):
    law, near = models(planar.robot, force)
    step = 2e-5
    for t in np.linspace(0.1, 0.6, 7):
        at = {k: law(*(link(t + k * step, order) for order in range(6))) for k in (-1, 0, 1)}
        for order in range(3):
            difference = (at[1][order] - at[-1][order]).full().ravel() / (2 * step)
            exact = at[0][order + 1].full().ravel()
            assert difference == pytest.approx(exact, rel=1e-5, abs=1e-5 * 10.0**order)
    # Out of rest, what the optimiser's rows hold is exact.
    rest = [np.array([0.2, 0.5]), *(np.zeros(2) for _ in range(5))]
    for order, first in ((1, 3), (2, 4), (3, 5)):
        leaving = [*rest[:first], np.array([3.0, -7.0]), *rest[first + 1 :]]
        assert near(*leaving)[order].full() == pytest.approx(law(*leaving)[order].full())
        assert np.all(law(*leaving)[order].full() != 0.0)


def test_approximate_motor_rows_are_close_to_exact_at_stiffness_kinks(planar, link):
    law, near = models(planar.robot)
    times = np.linspace(0.0, 0.7, 141)
    exact, seen = (
        np.array([f(*(link(t, k) for k in range(6)))[3].full().ravel() for t in times])
        for f in (law, near)
    )
    lead = exact - link(times, 3)
    assert np.max(np.abs(lead)) > 0.1 * np.max(np.abs(exact))
    assert np.max(np.abs(seen - exact)) < 0.03 * np.max(np.abs(exact))


def test_interpolated_motor_motion_follows_the_lead_law_between_samples(planar, link):
    robot = planar.robot
    motors = MotorLaw(robot).motion(link, LAW_SMOOTHING_FACTOR * SMOOTHING)
    law, _ = models(robot)
    assert motors.link is link
    times = np.linspace(0.0, 0.7, 997)
    for order, limit in enumerate((1e-7, 1e-5, 2e-3)):
        found = np.array(
            [law(*(link(t, k) for k in range(6)))[order].full().ravel() for t in times]
        )
        assert motors(times, order) == pytest.approx(found, abs=limit)
    for t, place in ((0.0, [0.2, 0.5]), (0.7, [1.1, -0.2])):
        assert motors(t) == pytest.approx(place, abs=1e-9)
        assert motors(t, 1) == pytest.approx(0.0, abs=1e-9)


def test_elastic_simulation_matches_the_prediction_and_has_no_residual_vibration(planar, link):
    motors = MotorLaw(planar.robot).motion(link, SMOOTHING)
    predicted = assess(planar, motors).deflection_summary()["dynamic"].peak
    arm = ElasticArm(planar.robot, motors(0.0))
    found = simulate(arm, MotorMotion.of(motors))
    assert found.peak == pytest.approx(predicted, rel=0.03)
    assert found.peak_after < 0.03 * predicted
    rigid = simulate(arm, MotorMotion.of(link))
    # Commanded without the lead, the same motion swings more than the lead leaves.
    assert rigid.peak_after > 3.0 * found.peak_after


def test_lead_at_the_sagged_links_reduces_residual_vibration(planar, link):
    law, arm = MotorLaw(planar.robot), ElasticArm(planar.robot, link(0.0))
    lag = round_lags(arm.lag(link(link.duration)))
    left = {}
    for sagged in (True, False):
        # Narrow corners: wide ones leave as much by themselves.
        motors = law.motion(link, 0.2 * SMOOTHING, lag, sagged=sagged)
        for t, place in ((0.0, [0.2, 0.5]), (motors.duration, [1.1, -0.2])):
            assert motors(t) == pytest.approx(place, abs=1e-9)
            assert motors(t, 1) == pytest.approx(0.0, abs=1e-9)
        left[sagged] = simulate(arm, MotorMotion.of(motors)).peak_after
    assert left[True] < 0.2 * left[False]


def test_motor_motion_is_extended_by_the_windup_lag(planar):
    # The fifth derivative is not zero at the ends: there the wind-up's third rate jumps.
    speed = 630.0 * Polynomial([0, 1]) ** 4 * Polynomial([1, -1]) ** 4
    second = speed.deriv().coef / 0.7 ** (2.0 + np.arange(8))
    change = np.array([0.9, -0.7])
    link = Trajectory([0.0, 0.7], second[None, :, None] * change, [0.2, 0.5], np.zeros(2))
    lag = np.array([6e-4, 8e-4])
    motors = MotorLaw(planar.robot).motion(link, SMOOTHING, lag)
    for j, own in enumerate(lag):
        waiting = motors(np.linspace(0.0, 0.99 * own, 50), 3)[:, j]
        # Meanwhile the links' own place moves a little.
        assert np.abs(waiting).max() < 0.1 * np.abs(motors(own, 3)[j])
    arrived = motors(np.linspace(0.7 + 1.001 * lag[0], motors.duration, 50), 3)[:, 0]
    assert np.abs(arrived).max() < 1e-6 * np.abs(motors(lag[0], 3)[0])


def test_command_moves_the_links_along_the_written_plan(planar, link, tmp_path):
    motors = MotorLaw(planar.robot).motion(link, SMOOTHING)
    times = export_times(motors.duration)
    write_trajectory(assess(planar, motors, times=times), tmp_path)
    written = np.genfromtxt(tmp_path / "trajectory.csv", delimiter=",", names=True)
    command = np.stack([written["q1"], written["q2"]], axis=1)
    planned = np.stack([written["link1"], written["link2"]], axis=1)
    speed = np.stack([written["qd1"], written["qd2"]], axis=1)
    assert planned == pytest.approx(link(written["t"]), abs=1e-12)
    arm = ElasticArm(planar.robot, command[0])
    found = simulate(arm, MotorMotion(written["t"], command, speed))
    at = np.minimum(found.time, motors.duration)
    wanted = arm.tool(arm.static_equilibrium(link(at)))
    missed = np.max(np.linalg.norm(arm.tool(found.position) - wanted, axis=1))
    # Commanded as they are planned, the links swing about that place.
    plain = simulate(arm, MotorMotion.of(link)).peak
    assert missed < 0.05 * plain


def test_planned_links_have_no_residual_vibration(planar):
    solution = solve(planar, simulate=True)
    assert solution.status.usable
    assert solution.assessment.worst_violation.value <= 5e-3
    assert solution.duration == pytest.approx(planar.duration[0], abs=1e-9)
    assert solution.trajectory.link.duration == solution.duration
    swinging = solution.simulation.optimised.simulated
    # The tool follows the planned path although it leads the motors by the wind-up.
    assert swinging.peak < 0.1 * solution.objective.value
    # Damping delays the wind-up: motors that know it leave a hundredth.
    assert swinging.peak_after < max(0.01 * solution.objective.value, 5e-6)


def test_boundary_velocities_are_kept(tmp_path):
    ends = "boundary_velocity = { start = [0.6, 0.4], end = [0.5, 0.3] }"
    solution = solve(load(tmp_path, minimise=GOAL, motion=ends))
    assert solution.status.usable
    assert solution.trajectory(0.0, 1) == pytest.approx([0.6, 0.4], abs=1e-2)
    assert solution.trajectory(solution.duration, 1) == pytest.approx([0.5, 0.3], abs=1e-2)


def test_free_boundary_acceleration_is_used(tmp_path, planar):
    freed = solve(load(tmp_path, minimise=GOAL, motion='boundary_acceleration = "free"'))
    assert freed.status.usable
    assert np.max(np.abs(freed.trajectory(0.0, 2))) > 1.0
    assert freed.objective.value < solve(planar).objective.value


def test_process_force_shifts_the_static_equilibrium(tmp_path):
    force = "[tool]\nprocess_force = [5.0, 2.0, -20.0]"
    problem = load(tmp_path, minimise=GOAL, extra=force)
    solution = solve(problem, simulate=True)
    assert solution.status.usable
    assert solution.trajectory([0.0])[0] == pytest.approx(problem.start.joints, abs=1e-9)
    swinging = solution.simulation.optimised.simulated
    assert swinging.peak < 0.1 * solution.objective.value
    assert swinging.peak_after < max(0.05 * solution.objective.value, 5e-6)


@pytest.mark.parametrize(
    ("pieces", "words"),
    [
        ({"method": 'transcription = "radau"'}, "piecewise_linear_acceleration"),
    ],
)
def test_link_planning_of_unsupported_problems_is_refused(pieces, words, tmp_path):
    with pytest.raises(InputError, match=words):
        solve(load(tmp_path, minimise=GOAL, **pieces))


def test_default_objective(planar):
    plain = replace(planar, objectives=())
    assert [each.name for each in plain.objectives] == ["tool_error"]
    assert plain.chosen == "tool_error is minimised, by default."
    radau = replace(plain, objectives=(), method=Method(transcription="radau"))
    assert [each.name for each in radau.objectives] == ["dynamic_deflection"]
    assert radau.chosen.startswith("dynamic_deflection is minimised, by default: tool_deviation")
    assert "needs the transcription" in radau.chosen
    assert planar.chosen == ""
    bare = replace(planar.robot, chains=(None, None))
    with pytest.raises(InputError, match="no drivetrain whose deflection could be the default"):
        replace(plain, robot=bare, objectives=())


def test_back_off_is_local_to_violations(planar):
    motion = resolve(planar)
    ocp = formulate(planar, motion, Scales())
    transcription = transcribe(ocp, "piecewise_linear_acceleration", uniform_mesh(8))
    x = transcription.pack(initial_guess(planar, motion, baselines(planar, motion)))
    rows = PointFunction(exact_path_rows(planar, motion, Scales()))
    excess = path_row_excess(transcription, x, Smoothing(SMOOTHING).parameters, rows)
    given = transcription.nlp
    nlp = back_off_exceeded(given, excess, given, most=0.1)
    change = transcription.nlp.upper_g - nlp.upper_g
    changed = np.flatnonzero(np.nan_to_num(change))
    assert max(excess.largest.values()) > 0.0
    assert changed.size
    assert np.all(change[changed] > 0.0)
    assert np.all(change[changed] <= 0.1 + 1e-12)
    names = {nlp.rows.entry(int(k)).name for k in changed}
    assert names <= {rows.name for rows in ocp.path_rows}
    # Again from there, bounds only move further in.
    further = back_off_exceeded(nlp, excess, given, most=0.1)
    assert np.all(np.nan_to_num(nlp.upper_g - further.upper_g) >= 0.0)


def test_repeated_back_off_applies_only_to_rows_backed_off_before(monkeypatch):
    monkeypatch.setattr(
        constraint_back_off, "replace", lambda nlp, **bounds: SimpleNamespace(**bounds)
    )
    index = np.arange(3)[:, None]
    near = np.array([[0.02], [0.02], [0.0]])
    block = SimpleNamespace(rows=SimpleNamespace(name="jerk"))
    excess = Excess({"jerk": 0.02}, ((block, index, near, np.zeros((3, 1))),))
    given = SimpleNamespace(lower_g=np.full(3, -1.0), upper_g=np.ones(3))
    before = SimpleNamespace(lower_g=np.full(3, -1.0), upper_g=np.array([0.9, 1.0, 0.9]))
    found = back_off_exceeded(before, excess, given, most=1.0, limits=("jerk",))
    assert found.upper_g[0] == pytest.approx(0.8)
    assert 1.0 - 2.0 * 0.02 < found.upper_g[1] < 1.0 - 0.02
    assert found.upper_g[2] == 0.9
    assert np.array_equal(found.lower_g, before.lower_g)


def test_back_off_from_both_sides_keeps_rows_feasible(monkeypatch):
    monkeypatch.setattr(
        constraint_back_off, "replace", lambda nlp, **bounds: SimpleNamespace(**bounds)
    )
    index, near = np.arange(2)[:, None], np.array([[0.7], [0.2]])
    block = SimpleNamespace(rows=SimpleNamespace(name="peak"))
    given = SimpleNamespace(lower_g=np.full(2, -0.5), upper_g=np.full(2, 0.5))
    found = back_off_exceeded(given, Excess({}, ((block, index, near, near),)), given, most=1.0)
    assert found.lower_g == pytest.approx([-0.5, -0.3])
    assert found.upper_g == pytest.approx([0.5, 0.3])


def test_exact_motor_rows_determine_the_back_off(planar):
    motion = resolve(planar)
    transcription = transcribe(
        formulate(planar, motion, Scales()), "piecewise_linear_acceleration", uniform_mesh(8)
    )
    x = transcription.pack(initial_guess(planar, motion, baselines(planar, motion)))
    rows = PointFunction(exact_path_rows(planar, motion, Scales()))
    duration = float(transcription.phase_durations(x).sum())
    times = np.linspace(0.0, duration, 201)
    speed = np.zeros((201, planar.joints))
    speed[times > 0.9 * duration, 1] = 1.5
    asked = (transcription, x, Smoothing(SMOOTHING).parameters, rows)
    plain = path_row_excess(*asked)
    found = path_row_excess(*asked, {"velocity": KnownRows(times, speed)})
    assert found.largest["velocity"] == pytest.approx(max(0.5, plain.largest["velocity"]))
    for (block, _, above, below), (_, _, known, same) in zip(found.near, plain.near, strict=True):
        changed = above != known
        assert np.array_equal(below, same)
        if block.rows.name != "velocity":
            assert not changed.any()
            continue
        assert changed.any()
        assert not changed[:, 0].any()
        late = transcription.times_of(block.places, x)
        assert np.all(np.sort(late)[changed[:, 1]] > 0.7 * duration)


def test_wide_smoothing_applies_to_the_lead_law_only(planar):
    problem = replace(planar, limits=replace(planar.limits, dynamic_deflection=1e-3))
    motion, random = resolve(problem), np.random.default_rng(3)
    rows = exact_path_rows(problem, motion, Scales())
    blocks = formulate(problem, motion, Scales()).path_rows
    names = [block.name for block in blocks for _ in block.labels]
    state, control = random.normal(size=10) * np.repeat([0.3, 1, 10, 1e2, 1e3], 2), np.zeros(2)
    narrow, wide = (
        rows(state, control, 1e-4, Smoothing(SMOOTHING, corners).parameters).full().ravel()
        for corners in (1.0, 4.0)
    )
    changed = {name for name, a, b in zip(names, narrow, wide, strict=True) if a != b}
    assert changed == {"velocity", "acceleration"}
    assert any("deflection" in name for name in names)
