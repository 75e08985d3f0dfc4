"""Problem families: warm-started solves with the results of cold ones."""

import io
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from small_arms import ROOT, load

from stiffopt import native, solve
from stiffopt.problem.files import load_problem
from stiffopt.problem.formulation import formulate
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.result.provenance import inputs_hash
from stiffopt.solver.family import ProblemFamily, WarmStart
from stiffopt.transcription import build
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.structure import same_bounds, scaled_like

BASE = ROOT / "problems" / "two_link.toml"
# Torque limits that bind make a start with multipliers worth something.
TIGHT = ("motion.duration=0.75 s", "method.intervals=40")


def problem(*changes):
    return load_problem(BASE, [*TIGHT, *changes]).problem


@pytest.fixture(scope="module")
def first():
    family = ProblemFamily()
    solution, end = family.solve(problem("payload.mass=0.3"))
    assert solution.status.usable
    return family, solution, end


@pytest.mark.parametrize(
    "change",
    [
        "payload.mass=0.33",
        "motion.duration=0.8 s",
        "motion.end.joints=[1.2, -0.4]",
        "motion.start.joints=[0.1, 0.0]",
        "limits.scale={ torque = 0.95 }",
        "tool.offset=[0.45, 0.0, 0.0]",
    ],
)
def test_similar_problem_reuses_the_programme(first, change):
    family, before, end = first
    near = problem("payload.mass=0.3", change)
    warm, _ = family.solve(near, end, compare=False)
    cold = solve(near)
    assert warm.status is cold.status
    assert warm.solver.build_s == 0.0
    assert warm.solver.iterations <= cold.solver.iterations
    assert warm.objective.value == pytest.approx(cold.objective.value, rel=2e-5)
    assert warm.objective.value != pytest.approx(before.objective.value, rel=1e-6) or (
        "scale" in change or "offset" in change
    )
    assert warm.baselines == {}


@pytest.mark.parametrize("goal", ["tool_deviation", "dynamic_deflection"])
def test_planned_links_start_from_the_solved_state(tmp_path, goal):
    stated = load(tmp_path, "planar", minimise=f'objective = "{goal}"', duration="0.6")
    longer = replace(stated, duration=(0.62, 0.62))
    family = ProblemFamily()
    _, end = family.solve(stated)
    again = WarmStart.from_bytes(end.to_bytes())
    assert again.back_off.tolist() == end.back_off.tolist()
    warm, _ = family.solve(longer, again)
    cold = solve(longer)
    assert warm.status is cold.status
    assert warm.solver.iterations < 0.6 * cold.solver.iterations
    # The mesh of the first motion remains, and with it its error.
    assert warm.objective.value <= cold.objective.value * 1.01


def test_a_command_is_chosen_as_that_of_the_solved_state(tmp_path, monkeypatch):
    stated = load(tmp_path, "planar", minimise='objective = "tool_deviation"', duration="0.9")
    longer, family = replace(stated, duration=(0.92, 0.92)), ProblemFamily()
    before, end = family.solve(stated, simulate=True, beside_rivals=False)
    end = WarmStart.from_bytes(end.to_bytes())
    own = before.compensation.optimised
    assert not own.excess
    assert end.command == (own.spacing, own.share, own.servo_share)
    # A choice that the limits exclude is made anew.
    other = replace(end, command=(own.spacing, 1e4, own.servo_share))
    again, _ = family.solve(longer, other, simulate=True, beside_rivals=False)
    assert again.compensation.optimised.share < 2.0
    monkeypatch.setattr("stiffopt.command.command_search._LeadWithinLimits", None)
    found, _ = family.solve(longer, end, simulate=True, beside_rivals=False)
    led = found.compensation.optimised
    assert (led.spacing, led.share, led.servo_share) == end.command
    # A new choice follows the planned lead, which is not within the limits of the shorter motion.
    assert led.compensated.worst_case <= 1.03 * again.compensation.optimised.compensated.worst_case


def test_warm_solution_is_that_of_the_problem_as_stated(first, monkeypatch):
    monkeypatch.setattr("stiffopt.solver.solve.questionable_springs", lambda *_: "soft springs")
    family, _, end = first
    stated = problem("payload.mass=0.33", "limits.travel=1.5")
    found, _ = family.solve(stated, end, simulate=True, beside_rivals=False)
    assert len(found.solver.homotopy) == 1
    assert found.inputs_hash == inputs_hash(stated)
    assert "soft springs" in found.notes


@pytest.mark.parametrize(
    ("goal", "other"),
    [("tool_deviation", "torque_squared"), ("torque_squared", "dynamic_deflection")],
)
def test_state_of_another_objective_does_not_prevent_a_solve(tmp_path, goal, other):
    stated, later = (
        load(tmp_path, "planar", minimise=f'objective = "{each}"', duration="0.6")
        for each in (goal, other)
    )
    _, end = ProblemFamily().solve(stated)
    found, _ = ProblemFamily().solve(later, WarmStart.from_bytes(end.to_bytes()))
    assert found.objective.value == pytest.approx(solve(later).objective.value, rel=1e-6)


def test_another_programme_is_built(first):
    family, _, end = first
    finer = problem("payload.mass=0.3", "method.intervals=50")
    solution, _ = family.solve(finer, end)
    assert solution.solver.build_s > 0.0
    assert solution.solver.intervals == 50
    assert set(solution.baselines) == {"toppra", "quintic"}


def test_bytes_of_other_layout_give_no_warm_start(first):
    older = io.BytesIO()
    empty = np.zeros(0)
    np.savez(
        older,
        x=empty,
        multipliers_x=empty,
        multipliers_g=empty,
        smoothing=np.array(1e-3),
        method=np.array("collocation 20"),
    )
    assert WarmStart.from_bytes(older.getvalue()) is None
    own = first[2].to_bytes()
    assert WarmStart.from_bytes(own) is not None
    assert all(WarmStart.from_bytes(own[:length]) is None for length in (0, 20, 1001, -8, -1))


def test_warm_start_round_trip_through_bytes(first):
    _, _, end = first
    again = WarmStart.from_bytes(end.to_bytes())
    assert again is not None
    assert again.x.tobytes() == end.x.tobytes()
    assert [share.tolist() for share in again.mesh] == [share.tolist() for share in end.mesh]
    assert (again.smoothing, again.scales, again.method) == (end.smoothing, end.scales, end.method)
    solution, _ = ProblemFamily().solve(problem("payload.mass=0.33"), again, compare=False)
    assert solution.status.usable
    assert solution.solver.build_s > 0.0


def test_failed_warm_start_falls_back_to_cold_solve(first):
    family, _, end = first
    x = np.full_like(end.x, np.nan)
    wrong = replace(end, x=x)
    solution, _ = family.solve(problem("payload.mass=0.33"), wrong)
    assert solution.status.usable
    assert solution.solver.intervals == 40


def test_infeasible_problem_is_reported_after_warm_start(first):
    family, _, end = first
    solution, following = family.solve(problem("motion.duration=0.2 s"), end)
    assert str(solution.status) == "infeasible"
    assert following is None


@pytest.mark.parametrize(
    ("change", "quick"),
    [
        ("payload.mass=0.33", True),
        ("motion.duration=0.8 s", False),
        ("motion.end.joints=[1.2, -0.4]", False),
        ("limits.scale={ torque = 0.95 }", True),
        ("limits.scale={ velocity = 0.95 }", False),
    ],
)
def test_programme_is_reused_only_for_the_same_set_of_bounds(monkeypatch, change, quick):
    def stated(*changes):
        near = problem("payload.mass=0.3", *changes)
        return formulate(near, resolve(near), Scales())

    made = build.transcribe(stated(), "piecewise_linear_acceleration", uniform_mesh(8))
    ocp = stated(change)
    taken = build.adapt(made, ocp)
    assert same_bounds(scaled_like(ocp, made.ocp), made.ocp) is quick
    monkeypatch.setattr(build, "same_bounds", lambda *_: False)
    built = build.adapt(made, ocp)
    for name in ("lower_x", "upper_x", "lower_g", "upper_g", "numbers"):
        assert np.array_equal(getattr(taken.nlp, name), getattr(built.nlp, name)), name
    # Torque is bounded relative to its limit, which is a number of the stage.
    assert np.array_equal(made.nlp.numbers, built.nlp.numbers) is not quick or "duration" in change


def test_a_programme_is_the_same_without_the_compiled_core(monkeypatch):
    stated = problem("payload.mass=0.3")
    ocp = formulate(stated, resolve(stated), Scales())
    fast = build.transcribe(ocp, "piecewise_linear_acceleration", uniform_mesh(8)).nlp
    monkeypatch.setattr(native, "library", lambda: None)
    slow = build.transcribe(ocp, "piecewise_linear_acceleration", uniform_mesh(8)).nlp
    for name in ("lower_x", "upper_x", "lower_g", "upper_g", "numbers"):
        np.testing.assert_array_equal(getattr(slow, name), getattr(fast, name), name)
    x = np.random.default_rng(7).normal(size=slow.variables.size)
    p = slow.parameters(Smoothing(1.0).parameters)
    for one, other in zip(values_of(slow, x, p), values_of(fast, x, p), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def values_of(nlp, x, p):
    return [each.full() for each in ca.Function("values", [nlp.x, nlp.p], [nlp.f, nlp.g])(x, p)]
