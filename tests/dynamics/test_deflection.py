from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from arms import arm, states

from stiffopt.dynamics.deflection import SpringTorques, spring_torques, tool_deflection
from stiffopt.dynamics.friction import DRY_FRICTION_WIDTH_SHARE, drive_torque, friction_torque
from stiffopt.dynamics.kinematics import point_jacobian
from stiffopt.robot.body_tree import body_tree

OFFSET = np.array([0.0, 0.05, 0.1])
FORCE = np.array([10.0, -20.0, -100.0])


def evaluate(name: str, force: object) -> tuple[dict[str, np.ndarray], pin.Model, np.ndarray]:
    model = arm(name)
    joint = model.njoints - 1
    x = [ca.SX.sym(part, model.nv) for part in "qva"]
    jacobian = point_jacobian(body_tree(model), joint, OFFSET, x[0])
    pushed = None if force is None else ca.mtimes(jacobian.T, force)
    torques = spring_torques(body_tree(model), *x, pushed)
    parts = tool_deflection(jacobian, torques, lambda tau: tau / 1e4 + np.tanh(tau) / 1e3)
    names = ["static", "dynamic", "process", "total"]
    outputs = [getattr(parts, part) for part in names]
    names += ["gravity", "motion", "spring", "jacobian"]
    outputs += [torques.gravity, torques.motion, torques.spring, jacobian]
    function = ca.Function("deflection", x, outputs)
    state = states(model, 1)[0]
    values = (np.asarray(value) for value in function(*state))
    return dict(zip(names, values, strict=True)), model, state


def test_torques_and_parts_follow_their_definitions() -> None:
    values, model, (q, v, a) = evaluate("sample", FORCE)
    data = model.createData()

    def phi(tau: np.ndarray) -> np.ndarray:
        return tau / 1e4 + np.tanh(tau) / 1e3

    jacobian = values["jacobian"]
    hold = pin.computeGeneralizedGravity(model, data, q).copy()
    motion = pin.rnea(model, data, q, v, a).copy()
    spring = motion - jacobian.T @ FORCE
    for key, expected in (("gravity", hold), ("motion", motion), ("spring", spring)):
        assert values[key].ravel() == pytest.approx(expected, rel=1e-11)
    assert values["static"].ravel() == pytest.approx(-jacobian @ phi(hold), rel=1e-11)
    dynamic = -jacobian @ (phi(motion) - phi(hold))
    assert values["dynamic"].ravel() == pytest.approx(dynamic, rel=1e-11)
    process = -jacobian @ (phi(spring) - phi(motion))
    assert values["process"].ravel() == pytest.approx(process, rel=1e-11)
    assert values["total"].ravel() == pytest.approx(-jacobian @ phi(spring), rel=1e-11)


def test_without_a_process_force_its_part_is_exactly_zero() -> None:
    values, _, _ = evaluate("sample", None)
    assert np.all(values["process"] == 0.0)


def test_force_deflects_tool_in_its_direction() -> None:
    values, _, _ = evaluate("sample", FORCE)
    assert float(FORCE @ values["process"].ravel()) > 0.0


def test_a_weight_pulls_the_tool_down() -> None:
    # One horizontal link of 1 m with 10 kg at its end, on a spring of 1e4 N m/rad.
    model = pin.Model()
    axis_y = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "shoulder")
    body = pin.Inertia(10.0, np.array([1.0, 0.0, 0.0]), np.zeros((3, 3)))
    model.appendBodyToJoint(axis_y, body, pin.SE3.Identity())
    q = ca.SX.zeros(1)
    torques = spring_torques(body_tree(model), q, q, q)
    jacobian = point_jacobian(body_tree(model), 1, [1.0, 0.0, 0.0], q)
    sag = ca.DM(tool_deflection(jacobian, torques, lambda tau: tau / 1e4).static)
    assert np.asarray(sag).ravel() == pytest.approx([0.0, 0.0, -10.0 * 9.81 / 1e4], rel=1e-12)


def test_arrays_and_symbols_agree() -> None:
    torques = SpringTorques(
        gravity=np.array([1.0, 2.0]),
        motion=np.array([3.0, 5.0]),
        spring=np.array([4.0, 1.0]),
        held=np.array([1.0, 2.0]),
    )
    jacobian = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    parts = tool_deflection(jacobian, torques, lambda tau: tau)
    assert parts.dynamic == pytest.approx([-2.0, -3.0, -5.0])
    assert parts.total == pytest.approx(-jacobian @ torques.spring)


def test_drive_carries_rotor_and_friction_on_top_of_the_spring() -> None:
    velocity, acceleration = np.array([0.5, -2.0]), np.array([3.0, 4.0])
    parts = {
        "rotor_inertia": np.array([0.3, 0.1]),
        "coulomb": np.array([4.0, 2.0]),
        "viscous": np.array([5.0, 1.0]),
        "velocity_max": np.array([4.0, np.inf]),
    }
    drive = drive_torque(np.array([10.0, -7.0]), velocity, acceleration, **parts)
    # Far from standstill the smooth sign is a sign.
    assert drive == pytest.approx([10 + 0.9 + 4 + 2.5, -7 + 0.4 - 2 - 2], rel=1e-9)
    symbol = ca.SX.sym("v", 2)
    tau = drive_torque(ca.SX([10.0, -7.0]), symbol, ca.SX(acceleration), **parts)
    assert np.asarray(ca.Function("drive", [symbol], [tau])(velocity)).ravel() == pytest.approx(
        drive, rel=1e-14
    )


def test_friction_is_odd_smooth_and_never_drives() -> None:
    speed = np.linspace(-1.0, 1.0, 2001)
    width = DRY_FRICTION_WIDTH_SHARE * 4.0
    friction = friction_torque(speed, coulomb=3.0, viscous=2.0, width=width)
    assert friction == pytest.approx(-friction[::-1], abs=1e-14)
    assert np.all(friction * speed >= 0.0)
    assert np.max(np.abs(friction)) <= 3.0 + 2.0
    at_width = friction_torque(width, coulomb=3.0, viscous=0.0, width=width)
    assert at_width == pytest.approx(3.0 * np.tanh(1.0))
    v = ca.SX.sym("v")
    slope = ca.gradient(friction_torque(v, coulomb=3.0, viscous=2.0, width=width), v)
    at, step = 0.03, 1e-6
    difference = np.diff(
        friction_torque(np.array([at - step, at + step]), coulomb=3.0, viscous=2.0, width=width)
    )[0] / (2 * step)
    assert float(ca.Function("slope", [v], [slope])(at)) == pytest.approx(difference, rel=1e-6)
