"""Input shaping: motions averaged over a period of the lowest mode."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_arms import load

from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.elastic.uncertainty import Departure
from stiffopt.errors import InputError, ProblemError
from stiffopt.problem.bounds import shortest_duration
from stiffopt.problem.resolve import resolve
from stiffopt.result.status import SolveStatus
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver import input_shaping
from stiffopt.solver.input_shaping import AveragedMotion
from stiffopt.solver.solve import solve

GOAL = 'objective = "shaped_deviation"'


def test_average_over_preceding_window_lasts_longer():
    motion = Trajectory.from_acceleration(
        [0.0, 0.1, 0.2], [[[5.0]], [[-5.0]]], np.array([0.3]), np.array([0.0])
    )
    averaged = AveragedMotion(motion, 0.05)
    assert averaged.duration == pytest.approx(0.25)
    for t in (0.02, 0.13, 0.22):
        before = np.linspace(t - 0.05, t, 20001)
        position = motion(np.clip(before, 0.0, 0.2))[:, 0]
        expected = np.trapezoid(position, before) / 0.05
        assert averaged(np.array([t]))[0, 0] == pytest.approx(expected, abs=1e-9)


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    via = 'via = [{ joints = [-0.3, 0.9], tolerance = "0.5 deg" }]'
    problem = load(
        tmp_path_factory.mktemp("arm"),
        minimise=GOAL,
        duration="1.2",
        motion=via,
        method="intervals = 24",
    )
    return problem, solve(problem, throw=False)


def test_shaped_motion_keeps_limits_vias_and_duration(solved):
    problem, solution = solved
    assert solution.status.usable
    assert solution.duration == pytest.approx(1.2)
    assert solution.objective.name == "shaped_deviation"
    assert solution.assessment.feasible(CERTIFICATE_TOLERANCE)
    miss = np.max(np.abs(solution.assessment.position - [-0.3, 0.9]), axis=1)
    assert np.min(miss) <= np.radians(0.5) * (1 + CERTIFICATE_TOLERANCE)
    assert solution.ratio_to_better_baseline < 1.0
    lowest = min(
        modes(ElasticArm(problem.robot, pose), pose)[0].frequency
        for pose in resolve(problem).points
    )
    assert f"{1e3 / lowest:.0f} ms" in solution.notes[-1]


def test_residual_vibration_is_small_on_nominal_and_softer_arm(solved):
    problem, solution = solved
    motion = MotorMotion.of(solution.trajectory)
    arm = ElasticArm(problem.robot, motion.at(0.0)[0])
    own = simulate(arm, motion)
    assert own.peak == pytest.approx(solution.objective.value, rel=0.1)
    assert own.peak_after < 0.02 * own.peak
    softer = simulate(arm.with_departure(Departure(stiffness=np.full(2, 0.8))), motion)
    assert softer.peak_after < 0.15 * own.peak


def test_free_duration_is_refused(tmp_path):
    with pytest.raises(InputError, match="needs a fixed duration"):
        load(tmp_path, minimise=GOAL, duration="{ lower = 0.5, upper = 2.0 }")


def test_too_short_a_duration_is_refused_before_solving(tmp_path):
    problem = load(tmp_path, minimise=GOAL)
    needed, _ = shortest_duration(problem, resolve(problem))
    hasty = replace(problem, duration=(1.01 * needed, 1.01 * needed))
    with pytest.raises(
        ProblemError, match=r"a period of the arm's lowest mode, .* leaves too little"
    ):
        solve(hasty)


def heavily_loaded(tmp_path, duration):
    problem = load(tmp_path, minimise=GOAL, method="intervals = 16")
    heavy = problem.robot.with_payload(15.0, [0.0, 0.0, 0.0], [0.1, 0.1, 0.1])
    limits = problem.active_limits
    limits = replace(limits, torque=20.0 * limits.torque)
    return replace(problem, robot=heavy, limits=limits, duration=(duration, duration))


@pytest.mark.slow
def test_too_long_window_is_replaced_by_a_shorter_one(tmp_path):
    problem = heavily_loaded(tmp_path, 0.42)
    solution = solve(problem, throw=False)
    assert solution.status is not SolveStatus.INFEASIBLE
    assert " a period of the arm's lowest mode" in solution.notes[-1]
    assert solution.duration == pytest.approx(0.42)


@pytest.fixture
def behind(monkeypatch):
    """A rival that is always better, so that every window is tried."""
    monkeypatch.setattr(input_shaping, "_rival_is_better", lambda *_: True)


def test_ctrl_c_in_a_later_window_keeps_the_first(tmp_path, behind, monkeypatch):
    problem = load(tmp_path, minimise=GOAL, duration="0.8", method="intervals = 12")
    plain, made = input_shaping._solve_averaged, []

    def averaged(*given):
        if made:
            return replace(made[0][0], status=SolveStatus.INTERRUPTED), None
        made.append(plain(*given))
        return made[0]

    monkeypatch.setattr(input_shaping, "_solve_averaged", averaged)
    solution = solve(problem, throw=False)
    assert solution.status is SolveStatus.INTERRUPTED
    assert solution.message.startswith("Stopped by the user")
    assert solution.assessment is made[0][1][1]


def test_all_windows_have_one_time_limit(tmp_path, behind, monkeypatch):
    problem = load(tmp_path, minimise=GOAL, duration="0.8", method="intervals = 12")
    given, clock = [], iter(range(0, 10_000, 70))
    monkeypatch.setattr(input_shaping, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    plain = input_shaping._TimedSolver.solve

    def noted(self, inner):
        def timed(problem):
            given.append(problem.method.time_limit)
            return self.plain(problem)

        return plain(replace(self, plain=timed), inner)

    monkeypatch.setattr(input_shaping._TimedSolver, "solve", noted)
    solve(problem, throw=False)
    assert given[0] == problem.method.time_limit - 70.0
    assert list(given) == sorted(given, reverse=True)
    assert 1 < len(given) <= 5


@pytest.mark.slow
def test_short_duration_uses_a_shorter_window(tmp_path):
    problem = load(tmp_path, minimise=GOAL, method="intervals = 24")
    heavy = problem.robot.with_payload(15.0, [0.0, 0.0, 0.0], [0.1, 0.1, 0.1])
    limits = problem.active_limits
    problem = replace(problem, robot=heavy, limits=replace(limits, torque=20.0 * limits.torque))
    problem = replace(problem, duration=(0.4847, 0.4847))
    solution = solve(problem)
    assert solution.assessment.feasible(CERTIFICATE_TOLERANCE)
    quintic = solution.baselines["quintic"]
    assert solution.objective.value < quintic.objective
    assert "of a period of the arm's lowest mode" in solution.notes[-1]
