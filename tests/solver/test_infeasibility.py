"""Infeasibility analysis: feasible rows, and the names of conflicting ones."""

import casadi as ca
import numpy as np
import pytest
from small_arms import load

from stiffopt import SolveStatus, native, solve
from stiffopt.problem.formulation import formulate
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve
from stiffopt.solver.infeasibility import _RelaxedProgramme, minimise_excess
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.nlp import Blocks, Nlp
from stiffopt.transcription.ocp import Rows


def programme(tmp_path, **changes):
    problem = load(tmp_path, "planar", duration="0.9", **changes)
    ocp = formulate(problem, resolve(problem), Scales())
    return transcribe(ocp, "piecewise_linear_acceleration", uniform_mesh(12))


def straight(made):
    """The middle of the bounds, ends where they are given."""
    low, high = (np.clip(b, -1.0, 1.0) for b in (made.nlp.lower_x, made.nlp.upper_x))
    return 0.5 * (low + high)


def test_feasible_rows_have_no_excess(tmp_path):
    made = programme(tmp_path, limits="tool_speed = 2.0")
    found = minimise_excess(made.nlp, straight(made), made.ocp.parameters)
    assert found.converged
    assert found.excess < 1e-4
    jacobian = made.nlp.derivatives["jac_g"]
    g, _ = jacobian(found.x, made.nlp.parameters(made.ocp.parameters))
    assert made.nlp.violations(g.full()).max() < 1e-4


def test_conflicting_row_is_named(tmp_path):
    made = programme(tmp_path, limits="tool_speed = 0.05")
    found = minimise_excess(made.nlp, straight(made), made.ocp.parameters)
    assert found.converged
    # Rows are of the squared speed over the limit.
    assert found.excess > 1.0
    assert found.conflicts[0].name == "tool_speed"


def test_derivatives_are_those_of_the_relaxed_programme(tmp_path, monkeypatch):
    # CasADi's own derivatives are the oracle.
    monkeypatch.setattr(native, "library", lambda: None)
    made = programme(tmp_path, limits="tool_speed = 0.5")
    x = straight(made)
    relaxed = _RelaxedProgramme(made.nlp, x, made.ocp.parameters).nlp
    random = np.random.default_rng(4)
    z = np.append(x + 0.1 * random.normal(size=len(x)), random.random(relaxed.x.numel() - len(x)))
    p, multipliers = made.nlp.parameters(made.ocp.parameters), random.normal(size=relaxed.g.numel())
    lagrangian = 0.7 * relaxed.f + ca.dot(multipliers, relaxed.g)
    wanted = ca.Function(
        "wanted",
        [relaxed.x, relaxed.p],
        [
            ca.gradient(relaxed.f, relaxed.x),
            ca.jacobian(relaxed.g, relaxed.x),
            ca.triu(ca.hessian(lagrangian, relaxed.x)[0]),
        ],
    )(z, p)
    found = (
        relaxed.derivatives["grad_f"](z, p)[1],
        relaxed.derivatives["jac_g"](z, p)[1],
        relaxed.derivatives["hess_lag"](z, p, 0.7, multipliers),
    )
    for own, other in zip(found, wanted, strict=True):
        assert ca.DM(own).full() == pytest.approx(ca.DM(other).full(), abs=1e-9)


@pytest.mark.parametrize("cap", ["0.5 um", "1 nm"])
def test_infeasible_cap_is_named_quickly(tmp_path, cap):
    limits = f'dynamic_deflection = "{cap}"'
    problem = load(tmp_path, "planar", duration="0.9", limits=limits)
    solution = solve(problem, throw=False)
    assert solution.status is SolveStatus.INFEASIBLE
    assert "conflict: dynamic_deflection, tool" in solution.message
    # One stage, and the least excess.
    assert len(solution.solver.homotopy) == 1
    assert solution.solver.iterations <= 250


def small():
    """Rows that hold together but for 0.025 and 0.02, from a point that exceeds one by 10,000."""
    x, p = ca.MX.sym("x", 2), ca.MX.sym("p")
    g = ca.vertcat(1e4 * x[0], 2e4 * x[0], x[1])
    rows, low, high = Blocks(), np.array([-np.inf, 0.05, 0.02]), np.array([0.0, np.inf, np.inf])
    for k, name in enumerate(("far", "beside", "near")):
        rows.add(
            Rows.make(name, [""], low[k], high[k]),
            None,
            low[k].reshape(1, 1),
            high[k].reshape(1, 1),
        )
    variables, lower, upper = Blocks(), np.array([-2.0, 0.0]), np.array([2.0, 0.0])
    variables.add(Rows.make("x", ["one", "two"], -2.0, 2.0), None, lower[:, None], upper[:, None])
    f, multipliers, sigma = ca.MX(0.0), ca.MX.sym("lam", 3), ca.MX.sym("sigma")
    derivatives = {
        "jac_g": ca.Function("nlp_jac_g", [x, p], [g, ca.jacobian(g, x)]),
        "hess_lag": ca.Function("nlp_hess_l", [x, p, sigma, multipliers], [ca.MX(2, 2)]),
    }
    return Nlp(
        x=x, p=p, f=f, g=g, variables=variables, rows=rows, lower_x=lower, upper_x=upper,
        lower_g=low, upper_g=high, derivatives=derivatives,
    )  # fmt: skip


def test_small_excess_after_large_start_is_exact():
    found = minimise_excess(small(), np.array([1.0, 0.0]), np.ones(1))
    assert found.converged
    assert found.excess == pytest.approx(0.045, rel=0.02)
    # The excess itself, not its rounding beside a large start.
    assert [each.name for each in found.conflicts[:2]] == ["far", "near"]


def test_slacks_of_scaled_rows_are_unscaled():
    relaxed = _RelaxedProgramme(small(), np.array([1.0, 0.0]), np.ones(1))
    assert relaxed.unscaled(np.array([1.0, 1.0, 1.0])) == pytest.approx([100.0, 1.0, 1.0])
