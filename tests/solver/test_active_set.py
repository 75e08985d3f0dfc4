"""Active-set warm start: the optima of IPOPT, verified by their KKT conditions, or none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from small_arms import ROOT

from stiffopt.problem.files import load_problem
from stiffopt.solver import active_set
from stiffopt.solver.active_set import ActiveSetSolver
from stiffopt.solver.family import ProblemFamily

# Torque limits bind over a third of the motion.
TIGHT = ("motion.duration=0.65 s", "limits.scale={ torque = 0.85 }", "method.intervals=40")


def problem(*changes):
    return load_problem(ROOT / "problems" / "two_link.toml", [*TIGHT, *changes]).problem


@pytest.fixture
def asked(monkeypatch):
    """Requests and results of `ActiveSetSolver`."""
    calls = []
    own = ActiveSetSolver.solve

    def noted(self, transcription, x0, parameters, near, report=None):
        raw = own(self, transcription, x0, parameters, near, report)
        calls.append((transcription, x0, parameters, near, raw))
        return raw

    monkeypatch.setattr(ActiveSetSolver, "solve", noted)
    return calls


@pytest.fixture(scope="module")
def first():
    family = ProblemFamily()
    return family, family.solve(problem("payload.mass=0.3"))[1]


def drawn(count):
    draw = np.random.default_rng(20)
    for _ in range(count):
        yield (
            f"payload.mass={draw.uniform(0.2, 0.4):.4f}",
            f"motion.duration={draw.uniform(0.63, 0.68):.4f}",
            f"motion.end.joints=[{draw.uniform(0.95, 1.02):.4f}, {draw.uniform(0.45, 0.55):.4f}]",
            f"limits.scale={{ torque = {draw.uniform(0.84, 0.95):.4f} }}",
        )


@pytest.mark.parametrize("changes", list(drawn(12)))
def test_active_set_optima_equal_those_of_ipopt(first, asked, changes):
    family, end = first
    solution, _ = family.solve(problem(*changes), end, compare=False)
    transcription, x0, parameters, near, raw = asked[0]
    solver = solver_of(family, transcription)
    other = solver.solve(x0, parameters, warm=near, barrier="adaptive")
    if raw is None:
        # Where it is not near, IPOPT has answered.
        assert str(solution.status) in ("optimal", "infeasible")
        return
    assert str(solution.status) == "optimal"
    assert solution.solver.iterations <= 8
    assert raw.objective == pytest.approx(other.objective, rel=1e-6)
    # IPOPT moves bounds by a hundred-millionth.
    assert raw.objective <= other.objective * (1.0 + 3e-8)
    assert conditions(transcription.nlp, solver, raw, parameters) < 1e-7


@pytest.mark.parametrize("change", ["payload.mass=5.5", "payload.mass=4.4", "motion.duration=1.55"])
def test_six_joints_with_their_dynamics(asked, change):
    path = ROOT / "problems" / "ur10_torque_squared.toml"
    family, same = ProblemFamily(), ("method.intervals=40", "payload.mass=5.0")
    _, end = family.solve(load_problem(path, same).problem)
    near = load_problem(path, [*same, change]).problem
    solution, _ = family.solve(near, end, compare=False)
    transcription, x0, parameters, before, raw = asked[0]
    assert raw is not None
    assert str(solution.status) == "optimal"
    solver = solver_of(family, transcription)
    other = solver.solve(x0, parameters, warm=before, barrier="adaptive")
    assert raw.objective == pytest.approx(other.objective, rel=1e-5)
    assert raw.objective <= other.objective * (1.0 + 3e-8)
    assert conditions(transcription.nlp, solver, raw, parameters) < 1e-7


def solver_of(family, transcription):
    kept = family._programmes.values()
    return next(made.solver for made in kept if made.transcription is transcription)


def conditions(nlp, solver, raw, parameters):
    """Largest residual of the conditions of Karush, Kuhn and Tucker."""
    p = nlp.parameters(parameters)
    gradient, jacobian, _ = solver.derivatives
    slope = np.asarray(gradient(raw.x, p)[1]).ravel()
    g, matrix = (np.asarray(each) for each in jacobian(raw.x, p))
    g = g.ravel()
    worst = [np.abs(slope + raw.multipliers_x + matrix.T @ raw.multipliers_g)]
    for value, lower, upper, force in (
        (raw.x, nlp.lower_x, nlp.upper_x, raw.multipliers_x),
        (g, nlp.lower_g, nlp.upper_g, raw.multipliers_g),
    ):
        slack = np.where(force > 0.0, upper - value, value - lower)
        worst += [
            np.maximum(lower - value, value - upper),
            np.abs(force * np.where(force, slack, 0.0)),
        ]
    return max(each.max(initial=0.0) for each in worst)


def test_most_similar_problems_are_solved(first, asked):
    family, end = first
    for changes in drawn(12):
        family.solve(problem(*changes), end, compare=False)
    assert sum(call[-1] is not None for call in asked) >= 9


def test_wrong_multipliers_give_the_optimum_or_none(first, asked):
    family, end = first
    heavier = problem("payload.mass=0.33")
    right, _ = family.solve(heavier, end, compare=False)
    draw = np.random.default_rng(3)
    for _ in range(3):
        wrong = replace(end, multipliers_g=draw.normal(size=len(end.multipliers_g)))
        solution, _ = family.solve(heavier, wrong, compare=False)
        assert solution.objective.value == pytest.approx(right.objective.value, rel=1e-6)


def test_unsupported_programmes_are_left_to_ipopt(asked):
    family = ProblemFamily()
    shortest = (
        'minimise=[{ objective = "duration" }]',
        'motion.duration={ lower = "0.3 s", upper = "2 s" }',
    )
    changes = (*shortest, 'motion.boundary_acceleration="free"')
    _, end = family.solve(problem("payload.mass=0.3", *changes))
    solution, _ = family.solve(problem("payload.mass=0.33", *changes), end, compare=False)
    assert solution.status.usable
    assert [call[-1] for call in asked] == [None]


def test_negative_curvature_is_rejected():
    curved, slope = csr_matrix(np.diag([1.0, -0.5, 2.0])), np.zeros(3)
    matrix, bounds = csr_matrix([[0.0, 1.0, 0.0]]), (np.array([-1.0]), np.array([1.0]))
    free, held = np.array([0]), np.array([1])
    assert (
        active_set._solve_quadratic_programme(curved, slope, matrix, bounds, np.zeros(1), free)
        is None
    )
    step, forces, _ = active_set._solve_quadratic_programme(
        curved, slope, matrix, bounds, np.zeros(1), held
    )
    assert step == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)
    assert forces == pytest.approx([0.5])


def test_dependent_rows_are_handled():
    curved, slope = csr_matrix(np.diag([1.0, 4.0])), np.array([-3.0, -2.0])
    matrix = csr_matrix([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    bounds = np.full(3, -np.inf), np.array([1.0, 1.0, 9.0])
    step, forces, side = active_set._solve_quadratic_programme(
        curved, slope, matrix, bounds, np.zeros(3), np.array([1, 1, 0])
    )
    assert step == pytest.approx([1.0, 0.5], abs=1e-8)
    assert forces.sum() == pytest.approx(2.0)
    assert side.tolist() == [1, 1, 0]


def test_infeasible_quadratic_programme_gives_none():
    curved, slope = csr_matrix(np.diag([1.0])), np.array([1.0])
    matrix = csr_matrix([[1.0], [1.0]])
    bounds = np.array([2.0, -np.inf]), np.array([np.inf, 1.0])
    assert (
        active_set._solve_quadratic_programme(
            curved, slope, matrix, bounds, np.zeros(2), np.zeros(2)
        )
        is None
    )
