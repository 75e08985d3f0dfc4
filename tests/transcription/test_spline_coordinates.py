"""Stage by spline coefficients: values and derivatives against CasADi's own."""

import casadi as ca
import numpy as np
import pytest

from stiffopt.transcription.node_derivatives import (
    NumberedStage,
    SplineCoordinates,
    extract_numbers,
)


@pytest.mark.parametrize("free", [False, True])
def test_derivatives_by_local_variables_agree_with_casadi(free):
    x, u, z, p = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("z"), ca.SX.sym("p")
    torque = ca.vertcat(u[0] * ca.cos(x[1]) + x[2] * x[3], 1.7 * u[1] * ca.sin(x[0]) + z)
    rows = ca.vertcat(torque[0] ** 2 * z, torque[1] / (p + x[2] ** 2), x[3] * u[0], z)
    stage = ca.Function("stage", [x, u, z, p], [ca.sumsqr(torque), rows])
    taken = extract_numbers(stage, ca.Function("through", [x, u, z, p], [torque]))
    # Second derivatives of cubic splines: positions and velocities are states.
    along = SplineCoordinates(((0, 2, 4), (1, 3, 5)), degree=3, statics=1, free=free)
    assert along.size == 2 * 4 + 1 + free
    values, jacobian, hessian = NumberedStage(
        taken.function, taken.numbers, taken.formula, along
    ).derivatives
    local, basis = ca.SX.sym("local", along.size), ca.SX.sym("basis", 12)
    weights = ca.SX.sym("weights", 5)
    w = along.variables(local, basis)
    direct = ca.vertcat(*stage(w[:4], w[4:6], w[6], p))
    true = [direct, ca.jacobian(direct, local), ca.hessian(ca.dot(weights, direct), local)[0]]
    reference = ca.Function("true", [local, basis, p, weights], true)
    random = np.random.default_rng(2)
    at, bases, each = (random.uniform(0.5, 1.5, size) for size in (along.size, 12, 5))
    given, expected = (at, 0.8, taken.numbers, bases), reference(at, bases, 0.8, each)
    found = [values(*given), jacobian(*given), hessian(*given, each)]
    for own, other in zip(found[:2], expected[:2], strict=True):
        np.testing.assert_allclose(own.full(), other.full(), rtol=1e-12, atol=1e-13)
    upper = np.triu(expected[2].full())
    np.testing.assert_allclose(found[2].full(), upper, rtol=1e-11, atol=1e-12)
