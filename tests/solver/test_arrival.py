"""Residual vibration: limited, minimised, and certified by elastic simulation."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from small_arms import joint, load, on_one_element, write_problem, write_robot

from stiffopt.command.simulation import damping_sensitive_limits, damping_sensitivity_note
from stiffopt.connection import Constant
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.errors import InputError
from stiffopt.problem.arrival_modes import ArrivalModes
from stiffopt.problem.files import load_problem
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.objective import OBJECTIVES, Scales, TermInputs
from stiffopt.problem.resolve import resolve
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.report.solve.wording import objective_phrase
from stiffopt.result.store import result_document
from stiffopt.solver import arrival, exact_rows, starts
from stiffopt.solver.refinement import refine
from stiffopt.solver.solve import solve
from stiffopt.solver.solve_run import SolveRun

FREE = "{ lower = 0.1, upper = 1.0 }"
DURATION = 'objective = "duration"'
EXCESS = 5e-3


@pytest.fixture(scope="module")
def shortest(tmp_path_factory):
    """Shortest motions of a swivel for limits on the residual vibration."""

    def solved(limits, simulate=False):
        folder = tmp_path_factory.mktemp("arm")
        problem = load(
            folder,
            "swivel",
            duration=FREE,
            minimise=DURATION,
            limits=f"jerk = [4000.0]\n{limits}",
            method="intervals = 16",
        )
        # A mode of 21 Hz.
        spring = Constant(name="spring", torque_max=60.0, stiffness=1500.0)
        problem = on_one_element(problem, spring)
        # Free vibration after arrival neglects damping.
        little = replace(problem.robot, damping=np.array([0.05]))
        problem = replace(problem, robot=little)
        return problem, solve(problem, simulate=simulate)

    return {
        "any": solved("", simulate=True),
        "residual": solved("residual_vibration = '0.4 mm'", simulate=True),
        "settling": solved("settling_time = '100 ms'\nsettling_band = '0.2 mm'"),
        "little": solved("residual_vibration = '5 um'"),
    }


def excess(solution, limit):
    return next(v.value for v in solution.assessment.violations if v.limit == limit)


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("residual", "residual_vibration"),
        ("settling", "settling_time"),
        ("little", "residual_vibration"),
    ],
)
def test_limits_hold_on_the_simulated_arm(shortest, name, limit):
    problem, solution = shortest[name]
    assert solution.status.usable
    assert excess(solution, limit) <= EXCESS
    # Judged by an independent simulation of the files.
    assessment = solution.assessment
    arm = ElasticArm(problem.robot, assessment.position[0])
    command = MotorMotion(assessment.time, assessment.position, assessment.velocity)
    limits = problem.active_limits
    found = simulate(arm, command, band=limits.settling_band)
    assert found.peak_after <= 1.01 * limits.residual_vibration
    assert (found.settling_time or 0.0) <= 1.01 * limits.settling_time
    assert np.allclose(assessment.velocity[-1], 0.0, atol=1e-6)


def test_smaller_residual_vibration_limit_takes_longer(shortest):
    took = {name: solution.duration for name, (_, solution) in shortest.items()}
    assert took["any"] < took["residual"] < took["little"]
    assert took["any"] < took["settling"] < took["little"]
    _, free = shortest["any"]
    assert free.assessment.simulated is None
    assert free.simulation.optimised.simulated.peak_after > 3e-4


def test_damping_sensitivity_is_noted(shortest):
    problem, solution = shortest["residual"]
    motion = solution.assessment
    # Its file states the damping.
    assert damping_sensitive_limits(problem, motion) == {}
    unstated = replace(problem, robot=replace(problem.robot, damping=None))
    command = MotorMotion(motion.time, motion.position, motion.velocity)
    critical = 2.0 * np.sqrt(
        1500.0 * float(problem.robot.rigid_bodies().inertia_matrix(np.zeros(1))[0, 0])
    )
    after = []
    for share in (0.01, 0.03):
        robot = replace(problem.robot, damping=np.array([share * critical]))
        after.append(simulate(ElasticArm(robot, motion.position[0]), command).peak_after)
    over = max(after) / problem.active_limits.residual_vibration - 1.0
    assert over > 0.0
    assert damping_sensitive_limits(unstated, motion) == pytest.approx({"residual_vibration": over})
    note = damping_sensitivity_note(unstated, motion)
    assert "residual_vibration" in note
    assert "damping" in note


def test_plan_ends_at_rest_without_optimum_with_vibration(shortest, monkeypatch):
    problem, _ = shortest["residual"]
    ways = []

    def unfinished(run, outcome):
        ways.append(bool(run.end_modes))
        found = refine(run, outcome)
        if run.end_modes:
            # It keeps all limits, and may be anywhere.
            return replace(found, raw=replace(found.raw, status="iteration_limit"))
        return found

    monkeypatch.setattr(starts, "refine", unfinished)
    solution = solve(problem, throw=False)
    assert ways == [True, False]
    assert solution.status.usable
    assert any("brings the links to rest" in note for note in solution.notes)


def test_residual_vibration_is_that_of_the_modes(shortest):
    """Predicted from the end state, within 10 % or 5 um of the simulated one."""
    problem, solution = shortest["residual"]
    link = solution.trajectory.link
    end = np.array([link.duration])
    arm = ElasticArm(problem.robot, link(0.0))
    [mode] = modes(arm, solution.assessment.position[-1])
    rate = 2.0 * np.pi * mode.frequency
    away = link(end)[0] - solution.assessment.position[-1]
    size = 0.4 * float(np.hypot(away, link(end, 1)[0] / rate)[0])
    found = solution.assessment.simulated.peak_after
    assert found == pytest.approx(size, rel=0.1, abs=5e-6)
    assert solution.compensation is None
    assert any("the plan has residual vibration" in note for note in solution.notes)


def test_residual_vibration_row_is_smooth():
    """One row bounds the sum of the amplitudes, smooth where single modes are at rest."""
    size = ca.SX.sym("size", 3)
    modes_at_rest = ArrivalModes(tuple(size[k] ** 2 for k in range(3)), np.array([1.0, 2.0, 3.0]))
    allowed, after = 1e-4, 0.1
    row = modes_at_rest.row("residual_vibration", allowed, after)
    value = ca.Function("value", [size], [row.expressions[0]])
    bend = ca.Function("bend", [size], [ca.hessian(row.expressions[0], size)[0]])
    random = np.random.default_rng(2)
    for sizes in np.abs(random.normal(size=(50, 3))):
        # On the bound; less 5 um that plans leave anyway.
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            inside = float(value(middle * allowed * sizes)) <= row.upper
            low, high = (middle, high) if inside else (low, middle)
        left = np.sum(low * allowed * sizes * np.exp(-modes_at_rest.decays * after))
        # The rounding at zero is 1 % of the limit.
        assert left <= (1.01 * row.upper + 1e-2) * allowed
    one = np.array([allowed, 0.0, 0.0])
    # A mode that rests has no corner: the row bends as far as it is from the other's size.
    assert float(np.abs(bend(one)).max()) * allowed**2 < 10.0
    alone = ArrivalModes((size[0] ** 2,), np.zeros(1)).row("residual_vibration", allowed, 0.0)
    single = ca.Function("single", [size], [alone.expressions[0]])
    assert float(single(one)) == pytest.approx(1.0, rel=1e-2)


def test_least_residual_vibration(tmp_path):
    problem = load(tmp_path, minimise='objective = "residual_vibration"')
    solution = solve(problem, simulate=True)
    assert solution.status.usable
    after = solution.simulation.optimised.simulated.peak_after
    # The tool error after arrival is measured from the planned path, which ends beside rest.
    assert solution.objective.value == pytest.approx(after, abs=1e-6)
    assert after < 5e-6
    assert solution.ratio_to_better_baseline < 0.05
    document = result_document(solution)
    assert document["objective"]["name"] == "residual_vibration"
    assert objective_phrase("residual_vibration", "") == "residual vibration of the tool"


def test_snap_is_scaled_without_velocity_limit(tmp_path):
    wanted = {"minimise": 'objective = "residual_vibration"', "limits": 'velocity = "none"'}
    problem = load(tmp_path, **wanted)
    assert not np.isfinite(problem.active_limits.velocity).any()
    snap = ca.SX.sym("snap", problem.joints)
    kind, (objective,) = OBJECTIVES["residual_vibration"], problem.objectives
    terms = kind.terms(TermInputs(objective, problem, SimpleNamespace(snap=snap), (), Scales()))
    value = ca.Function("value", [snap], terms.integrands)
    for own in np.eye(problem.joints):
        assert float(value(own)) > 0.0


BESIDE = {
    "path": (
        {
            "start": None,
            "motion": "path = [[-0.6, 0.4], [0.0, 0.3], [0.3, 0.3], [0.5, 0.2]]",
            "limits": "settling_time = '50 ms'",
        },
        ["limits.settling_time", "motion.path", "leave limits.settling_time out"],
    ),
    "transcription": (
        {"method": 'transcription = "radau"', "limits": "residual_vibration = '0.1 mm'"},
        ["limits.residual_vibration", "piecewise_linear_acceleration"],
    ),
    "moving end": (
        {
            "motion": "boundary_velocity = { start = [0.0, 0.0], end = [0.1, 0.0] }",
            "limits": "residual_vibration = '0.1 mm'",
        },
        ["limits.residual_vibration", "ends with a velocity", "boundary_velocity.end"],
    ),
    "objective": (
        {
            "motion": "boundary_velocity = { start = [0.0, 0.0], end = [0.1, 0.0] }",
            "minimise": 'objective = "residual_vibration"',
        },
        ["residual_vibration", "ends with a velocity"],
    ),
    "negative": ({"limits": "residual_vibration = -1.0"}, ["residual_vibration", "above 0"]),
    "too long": ({"limits": "settling_time = '2 s'"}, ["settling_time", "1"]),
}


@pytest.mark.parametrize("case", BESIDE)
def test_unsupported_arrival_limits_are_refused(case, tmp_path):
    pieces, words = BESIDE[case]
    path = write_problem(tmp_path, **{k: v for k, v in pieces.items() if v is not None})
    if case == "path":
        text = path.read_text().splitlines()
        path.write_text("\n".join(x for x in text if not x.startswith(("start =", "end ="))))
    with pytest.raises(InputError) as error:
        load_problem(path)
    for word in words:
        assert word in str(error.value)
    assert str(error.value).count("\n") == 0


def test_rigid_arm_has_no_residual_vibration(tmp_path):
    path = write_problem(tmp_path, limits="residual_vibration = '0.1 mm'")
    write_robot(tmp_path, "planar", joints=[joint("shoulder", ""), joint("elbow", "")])
    with pytest.raises(InputError, match="no drivetrain"):
        load_problem(path)


@pytest.mark.parametrize("simulated", [0.0, 0.02])
def test_an_arm_simulated_for_less_than_the_limit_is_judged_by_its_last_instant(simulated):
    swing = SimpleNamespace(
        time=np.array([0.0, 0.5, 0.5 + simulated]),
        duration=0.5,
        distance=np.array([0.0, 2e-4, 1e-4]),
    )
    limits = SimpleNamespace(settling_time=0.05, settling_band=5e-5)
    assert LIMITS["settling_time"].overshoot(limits, swing) == pytest.approx(
        1.0 if simulated else 3.0
    )


def test_wide_smoothing_requires_rest_at_arrival(tmp_path):
    limited = load(
        tmp_path,
        "swivel",
        duration="{ upper = 2.0 }",
        minimise='objective = "duration"',
        limits='residual_vibration = "50 um"',
    )
    for corners, swings in ((1.0, True), (4.0, False)):
        run = SolveRun(limited, resolve(limited), Scales(), None)
        run.__dict__["motor_smoothing"] = corners
        assert bool(run.end_modes) == swings


def test_back_off_reserves_all_drives_first_then_jerk():
    blocks = SimpleNamespace(rows=SimpleNamespace(items=[]))
    outcome = SimpleNamespace(smoothing=Smoothing(1.0, 8.0), nlp=blocks)
    oracle = arrival.ArrivalVibration(None)
    first, then = (
        oracle._requested_back_off(outcome, {"settling_time": 2.0}, again) for again in (0, 1)
    )
    # Of torque no more: it holds the arm's weight as well.
    assert set(first) == set(exact_rows.DRIVE_LIMITS)
    assert set(then) == {"jerk"}
