from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from arms import NAMES, arm, states

from stiffopt.dynamics.newton_euler import inverse_dynamics, newton_euler
from stiffopt.errors import RobotError
from stiffopt.robot.body_tree import body_tree


@pytest.mark.parametrize("name", NAMES)
def test_torques_are_those_of_pinocchio(name: str) -> None:
    model = arm(name)
    function = inverse_dynamics(body_tree(model))
    data = model.createData()
    expected, computed = [], []
    for q, v, a in states(model):
        expected.append(pin.rnea(model, data, q, v, a).copy())
        computed.append(np.asarray(function(q, v, a)).ravel())
    scale = np.max(np.abs(expected))
    assert np.max(np.abs(np.subtract(expected, computed))) < 1e-12 * scale


@pytest.mark.parametrize("name", NAMES)
def test_jacobians_are_those_of_pinocchio(name: str) -> None:
    model = arm(name)
    x = [ca.SX.sym(part, model.nv) for part in "qva"]
    tau = newton_euler(body_tree(model), *x)
    function = ca.Function("jacobians", x, [ca.jacobian(tau, part) for part in x])
    data = model.createData()
    for q, v, a in states(model, 5):
        dq, dv, da = (matrix.copy() for matrix in pin.computeRNEADerivatives(model, data, q, v, a))
        # pin fills the upper triangle of the joint-space inertia only.
        da = np.triu(da) + np.triu(da, 1).T
        scale = max(np.max(np.abs(m)) for m in (dq, dv, da))
        for ours, pins in zip(function(q, v, a), (dq, dv, da), strict=True):
            assert np.max(np.abs(np.asarray(ours) - pins)) < 1e-12 * scale


@pytest.mark.parametrize("name", ["ur10", "skew"])
def test_second_derivatives_agree_with_differences(name: str) -> None:
    model = arm(name)
    n = model.nv
    x, weight = ca.SX.sym("x", 3 * n), ca.SX.sym("w", n)
    tau = newton_euler(body_tree(model), x[:n], x[n : 2 * n], x[2 * n :])
    hessian, gradient = ca.hessian(ca.dot(weight, tau), x)
    function = ca.Function("second", [x, weight], [hessian, gradient])
    rng = np.random.default_rng(5)
    for _ in range(3):
        at, w = rng.uniform(-2, 2, 3 * n), rng.uniform(-1, 1, n)
        exact = np.asarray(function(at, w)[0])
        step = 1e-5
        columns = [
            (np.asarray(function(at + d, w)[1]) - np.asarray(function(at - d, w)[1])) / (2 * step)
            for d in step * np.eye(3 * n)
        ]
        assert np.max(np.abs(np.hstack(columns) - exact)) < 1e-4 * np.max(np.abs(exact))


def test_the_graph_of_an_industrial_arm_stays_small() -> None:
    function = inverse_dynamics(body_tree(arm("ur10")))
    assert function.n_nodes() < 600
    assert function.jacobian().n_nodes() < 4000


@pytest.mark.parametrize("name", ["sample", "skew"])
def test_gravity_torque_by_constant_zeros(name: str) -> None:
    model = arm(name)
    q = ca.SX.sym("q", model.nv)
    rest = np.zeros(model.nv)
    gravity = ca.Function("gravity", [q], [newton_euler(body_tree(model), q, rest, rest)])
    data = model.createData()
    for position, _, _ in states(model, 5):
        expected = pin.computeGeneralizedGravity(model, data, position)
        assert np.asarray(gravity(position)).ravel() == pytest.approx(expected, abs=1e-11)
    assert gravity.n_nodes() < inverse_dynamics(body_tree(model)).n_nodes() / 2


def test_mx_and_numbers_give_the_same_torques() -> None:
    model = arm("sample")
    x = [ca.MX.sym(part, model.nv) for part in "qva"]
    mapped = ca.Function("mx", x, [newton_euler(body_tree(model), *x)])
    state = states(model, 1)[0]
    expected = np.asarray(inverse_dynamics(body_tree(model))(*state))
    assert np.array_equal(np.asarray(mapped(*state)), expected)
    assert np.asarray(newton_euler(body_tree(model), *state)) == pytest.approx(expected, rel=1e-12)


def test_gravity_of_the_model_is_used() -> None:
    model = arm("skew")
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    q, v, a = states(model, 1)[0]
    expected = pin.rnea(model, model.createData(), q, v, a)
    assert np.asarray(inverse_dynamics(body_tree(model))(q, v, a)).ravel() == pytest.approx(
        expected
    )


@pytest.mark.parametrize(
    ("joint", "kind"),
    [
        (pin.JointModelFreeFlyer(), "floating"),
        (pin.JointModelPlanar(), "planar"),
        (pin.JointModelSpherical(), "spherical"),
        (pin.JointModelRUBZ(), "unbounded revolute"),
        (pin.JointModelHX(0.1), "hx"),
    ],
)
def test_other_joints_are_refused_by_name(joint: object, kind: str) -> None:
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3.Identity(), "odd_one")
    with pytest.raises(RobotError, match=f"'odd_one' is of the kind {kind}.*revolute and prismat"):
        body_tree(model)
