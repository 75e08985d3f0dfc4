"""Orders of convergence on an optimum with exact solution."""

import numpy as np
import pytest
from textbook import block_move

from stiffopt.solver.ipopt import IpoptOptions, IpoptSolver
from stiffopt.transcription import transcribe, uniform_mesh

TIGHT = IpoptOptions(tol=1e-12)


def test_piecewise_linear_optimum_has_order_two():
    case = block_move()
    counts = [10, 20, 40]
    errors = []
    for count in counts:
        made = transcribe(case.ocp, "piecewise_linear_acceleration", uniform_mesh(count))
        found = IpoptSolver(made.nlp, TIGHT).solve(made.pack(case.guess))
        errors.append(found.objective - 12.0)
    slope = float(np.polyfit(np.log(counts), np.log(errors), 1)[0])
    assert slope == pytest.approx(-2.0, abs=0.05)


@pytest.mark.parametrize("method", ["hermite_simpson", "radau"])
def test_high_orders_are_exact_on_the_block_move(method):
    case = block_move()
    made = transcribe(case.ocp, method, uniform_mesh(3))
    found = IpoptSolver(made.nlp, TIGHT).solve(made.pack(case.guess))
    motion = made.unpack(found.x)
    assert found.objective == pytest.approx(12.0, abs=1e-9)
    t = motion.times
    assert motion.states[:, 0] == pytest.approx(3 * t**2 - 2 * t**3, abs=1e-9)
    times = made.times_of(made.scheme.control_places(made.intervals), found.x)
    assert motion.controls[:, 0] == pytest.approx(6 - 12 * times, abs=1e-8)
