"""Orders of convergence on equations and optima with exact solutions."""

import casadi as ca
import numpy as np
import pytest
from textbook import block_move, guess, problem, second_order

from stiffopt.solver.ipopt import IpoptOptions, IpoptSolver
from stiffopt.transcription import transcribe, uniform_mesh

TIGHT = IpoptOptions(tol=1e-12)


def slope(errors: list[float], counts: list[int]) -> float:
    return -float(np.polyfit(np.log(counts), np.log(errors), 1)[0])


def end_error(method: str, intervals: int, degree: int) -> float:
    """x' = -x^2 cos(t) by a clock state has x = 1/(1 + sin(t)); the control is held at zero."""
    ocp = problem(
        "equation",
        "x clock",
        "u",
        lambda x, u: [-(x[0] ** 2) * np.cos(x[1]) + u[0], ca.SX(1)],
        start=[1, 0],
        end=[None, None],
        duration=(2, 2),
        control_bounds=[(0, 0)],
        objective=lambda integrals, total, xf: 0,
    )
    made = transcribe(ocp, method, uniform_mesh(intervals), degree=degree)
    start = guess(lambda s: [1 / (1 + np.sin(2 * s)), 2 * s], [0.0], 2.0)
    found = IpoptSolver(made.nlp, TIGHT).solve(made.pack(start))
    assert found.converged
    return abs(float(made.unpack(found.x).states[-1, 0]) - 1 / (1 + np.sin(2.0)))


@pytest.mark.parametrize(
    ("method", "degree", "counts", "order"),
    [
        ("piecewise_linear", 0, [20, 40, 80], 2.0),
        ("hermite_simpson", 0, [10, 20, 40], 4.0),
        ("radau", 1, [20, 40, 80], 1.0),
        ("radau", 2, [10, 20, 40], 3.0),
        ("radau", 3, [4, 8, 16], 5.0),
    ],
)
def test_states_converge_with_the_order_of_the_scheme(method, degree, counts, order):
    errors = [end_error(method, count, degree or 3) for count in counts]
    assert slope(errors, counts) == pytest.approx(order, abs=0.35)


def test_piecewise_linear_optimum_of_second_order_states_has_order_two():
    case = second_order(block_move())
    counts = [10, 20, 40]
    errors = []
    for count in counts:
        made = transcribe(case.ocp, "piecewise_linear", uniform_mesh(count))
        found = IpoptSolver(made.nlp, TIGHT).solve(made.pack(case.guess))
        errors.append(found.objective - 12.0)
    assert slope(errors, counts) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("method", ["hermite_simpson", "radau"])
def test_high_orders_are_exact_on_the_block_move(method):
    case = second_order(block_move())
    made = transcribe(case.ocp, method, uniform_mesh(3))
    found = IpoptSolver(made.nlp, TIGHT).solve(made.pack(case.guess))
    motion = made.unpack(found.x)
    assert found.objective == pytest.approx(12.0, abs=1e-9)
    t = motion.times
    assert motion.states[:, 0] == pytest.approx(3 * t**2 - 2 * t**3, abs=1e-9)
    assert motion.controls[:, 0] == pytest.approx(6 - 12 * motion.control_times, abs=1e-8)
