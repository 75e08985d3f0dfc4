"""Stages: meshes, smoothing and solver options."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stiffopt.baseline.baselines import baselines
from stiffopt.problem.files import load_problem
from stiffopt.problem.formulation import formulate
from stiffopt.problem.objective import Objective, Scales
from stiffopt.problem.resolve import resolve
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.solver.initial_guess import initial_guess
from stiffopt.solver.ipopt import IpoptSolver
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import plan_stages, solver_options
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.ocp import shortest_phase_share

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"


@pytest.mark.parametrize(
    ("intervals", "expected"), [(60, [30, 40, 60]), (300, [60, 100, 300]), (20, [16, 16, 20])]
)
def test_first_meshes_of_a_peak_do_not_grow_with_the_last(intervals, expected):
    problem = load_problem(PROBLEMS / "ur10_dynamic_deflection.toml").problem
    assert [stage.intervals for stage in plan_stages(problem, intervals)] == expected


@pytest.mark.parametrize(("jerk", "corners"), [(1.0, 1.0), (0.3, 2.0)])
def test_initial_smoothing_is_as_wide_as_a_smooth_motion_needs(jerk, corners):
    # With 0.3 of the jerk, the narrowest law asks for 2.3 times the limit, the next for 1.5 times.
    changes = [f"limits.scale.jerk={jerk}"]
    problem = load_problem(PROBLEMS / "ur10_tool_deviation.toml", changes).problem
    motion = resolve(problem)
    quintic = baselines(problem, motion)["quintic"]
    run = SolveRun(problem, motion, Scales(), None, quintic)
    assert run.motor_smoothing == corners
    assert {s.smoothing.lead for s in plan_stages(problem, 40, run.motor_smoothing)} == {corners}


def test_minimum_duration_starts_near_the_guess():
    problem = load_problem(PROBLEMS / "ur10_torque_squared.toml").problem
    problem = replace(problem, duration=(0.3, 5.0), objectives=(Objective(name="duration"),))
    motion = resolve(problem)
    ocp = formulate(problem, motion, Scales())
    made = transcribe(ocp, problem.method.transcription, uniform_mesh(20))
    guess = initial_guess(problem, motion, baselines(problem, motion))
    found = IpoptSolver(made.nlp, solver_options(problem)).solve(made.pack(guess), ocp.parameters)
    assert found.status == "optimal"
    # With IPOPT's own first multipliers it comes from 1.2 s by way of 4.3 s to 1.0 s.
    assert max(each.objective for each in found.history) < 1.5 * guess.duration


@pytest.mark.parametrize("longest", [None, 5.0])
def test_start_of_planned_links_keeps_the_limits_where_the_time_is_free(longest):
    problem = load_problem(PROBLEMS / "ur10_tool_deviation.toml", ["motion.duration=0.8"]).problem
    problem = problem if longest is None else replace(problem, duration=(0.3, longest))
    motion, limits = resolve(problem), problem.active_limits
    compared = baselines(problem, motion)
    guess = initial_guess(problem, motion, compared)
    states, n = guess.states(np.linspace(0.0, 1.0, 2001)), problem.joints
    used = max(
        np.max(np.abs(states[:, (k + 1) * n : (k + 2) * n]) / getattr(limits, name))
        for k, name in enumerate(("velocity", "acceleration", "jerk"))
    )
    if longest is None:
        assert guess.duration == 0.8
        assert used > 1.0
    else:
        assert guess.duration > 1.2 * compared["toppra"].assessment.duration
        assert used == pytest.approx(1.0, rel=1e-3)
    # Rates are those of the positions in that time.
    rate = np.gradient(states[:, :n], guess.duration / 2000, axis=0)
    np.testing.assert_allclose(rate[1:-1], states[1:-1, n : 2 * n], atol=1e-3)


def test_coarse_meshes_grow_with_the_phases():
    problem = load_problem(PROBLEMS / "er3a_pick_and_place.toml").problem
    many = replace(problem, vias=problem.vias[:1] * 30)
    coarse, middle, fine = plan_stages(many, 600)
    assert coarse.intervals >= 6 * 31
    assert middle.intervals >= 10 * 31
    assert fine.intervals == 600
    # The last mesh is solved to the end with the first correction of its rows.
    assert coarse.tolerance > fine.tolerance > problem.method.tolerance
    assert {each.tolerance for each in plan_stages(problem, 600)} == {None}
    near = solver_options(replace(many, method=replace(many.method, intervals=600)), near=True)
    assert near.extra["mu_init"] < near.extra["mu_max"] < 1e-4
    assert solver_options(many).max_iterations > solver_options(problem).max_iterations


@pytest.mark.parametrize(
    "name",
    ["er3a_pick_and_place", "er3a_pick_and_place_torque_squared", "er3a_tool_deviation"],
)
def test_phases_have_enough_intervals_however_few_are_stated(name):
    problem = load_problem(PROBLEMS / f"{name}.toml").problem
    many = replace(problem, vias=problem.vias[:1] * 20)
    assert plan_stages(many, 40)[-1].intervals == 6 * 21
    assert plan_stages(many, 40)[0].intervals >= 3 * 21


def test_smooth_problems_with_many_phases_start_on_a_coarse_mesh():
    path = PROBLEMS / "er3a_pick_and_place_torque_squared.toml"
    problem = load_problem(path).problem
    free = replace(problem, robot=replace(problem.robot, coulomb=np.zeros(problem.joints)))
    assert [each.intervals for each in plan_stages(free, 60)] == [60]
    many = replace(free, vias=problem.vias[:1] * 9)
    assert [each.intervals for each in plan_stages(many, 200)] == [50, 200]


def test_dry_friction_narrows_stage_by_stage():
    problem = load_problem(PROBLEMS / "er3a_pick_and_place_torque_squared.toml").problem
    stages = plan_stages(problem, 60)
    assert [(each.intervals, each.smoothing.kinks) for each in stages] == [
        (60, 16.0),
        (60, 4.0),
        (60, 1.0),
    ]
    many = replace(problem, vias=problem.vias[:1] * 9)
    *convex, last = plan_stages(many, 200)
    assert [(each.intervals, each.smoothing.kinks, each.new_mesh) for each in convex] == [
        (50, 16.0, False),
        (50, 4.0, False),
        (200, 2.0, True),
        (200, 1.0, False),
    ]
    assert all(each.smoothing.convexity == 1.0 for each in convex)
    assert all(each.tolerance > 1e3 * problem.method.tolerance for each in convex)
    # The optimum is that of the exact charge, to the problem's tolerance.
    assert last.smoothing == Smoothing(1.0)
    assert (last.intervals, last.new_mesh, last.tolerance) == (200, False, None)


@pytest.mark.parametrize("vias", [1, 9, 99])
def test_phases_have_room_in_the_duration(vias):
    share = shortest_phase_share(vias + 1)
    assert (vias + 1) * share <= 0.2
    assert share <= 0.02
