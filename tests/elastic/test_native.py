"""Compiled core against Python and pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from elastic_arms import arm, bang, one_soft_joint, there_and_stop
from small_arms import write_robot

from stiffopt import native
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.response import ElasticResponse
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.simulate import _Equations, simulate
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import ParameterBox, Uncertainty
from stiffopt.result.trajectory import ForceHistory
from stiffopt.robot.files import load_robot

pytestmark = pytest.mark.skipif(native.library() is None, reason="needs the compiled core")


def shaken(n):
    """A motion of n motors that is like no other at any instant."""
    time = np.linspace(0.0, 0.4, 41)
    angle = np.outer(time, np.arange(1, n + 1) * 7.0)
    return MotorMotion(time, 0.3 * np.sin(angle), 2.1 * np.arange(1, n + 1) * np.cos(angle))


@pytest.mark.parametrize("name", ["er3a_c60", "ur10", "planar", "slide", "spatial"])
@pytest.mark.parametrize("loops", [False, True])
def test_compiled_state_derivative_agrees_with_python(tmp_path, name, loops):
    robot = load_robot(name if name in ("er3a_c60", "ur10") else write_robot(tmp_path, name))
    if loops:
        robot = replace(robot, hysteresis=np.where(np.arange(robot.n) == 1, 0.0, 4e-5))
    arm = ElasticArm(robot, np.zeros(robot.n), (30.0, -20.0, 50.0))
    equations = _Equations(arm, shaken(robot.n))
    compiled = equations.slope()
    assert compiled != equations.__call__
    rng = np.random.default_rng(3)
    for t in (0.0, 0.123, 0.4, 0.7):
        state = np.concatenate(
            [
                equations._motor.at(t)[0] + 2e-4 * rng.normal(size=robot.n),
                rng.normal(size=robot.n),
                rng.uniform(-1.0, 1.0, equations.loops),
            ]
        )
        slow = equations(t, state)
        np.testing.assert_allclose(
            compiled(t, state), slow, rtol=1e-9, atol=1e-10 * abs(slow).max()
        )


def test_compiled_rigid_joints_agree_with_python(tmp_path):
    arm = one_soft_joint(tmp_path)
    equations = _Equations(arm, shaken(2))
    state = np.array([0.1, -0.2, 1.0, 2.0])
    for t in (0.0, 0.2, 0.5):
        np.testing.assert_allclose(equations.slope()(t, state), equations(t, state), rtol=1e-11)


def test_compiled_simulation_agrees_with_python(tmp_path, monkeypatch):
    swinging = arm(tmp_path, "planar", at=(0.3, 0.4))
    command = bang((3.0, -4.0), 0.2, (0.3, 0.4))
    quick = simulate(swinging, command)
    monkeypatch.setattr(native, "loaded", lambda: None)
    slow = simulate(swinging, command)
    assert quick.peak == pytest.approx(slow.peak, rel=1e-6)
    np.testing.assert_allclose(quick.position, slow.position, atol=1e-9)


def test_compiled_simulation_agrees_with_python_under_a_force_along_the_path(tmp_path, monkeypatch):
    force = ForceHistory(np.array([0.0, 0.1, 0.3]), np.array([[0, 0, 0], [5, -3, 0], [-2, 4, 0.0]]))
    swinging = arm(tmp_path, "planar", at=(0.3, 0.4)).under(force)
    command = bang((3.0, -4.0), 0.2, (0.3, 0.4))
    quick = simulate(swinging, command)
    monkeypatch.setattr(native, "loaded", lambda: None)
    # The integrator's steps differ at kinks of the force.
    np.testing.assert_allclose(quick.position, simulate(swinging, command).position, atol=1e-7)


@pytest.mark.parametrize("soft", [1, 2])
def test_compiled_batch_agrees_with_numpy(tmp_path, monkeypatch, soft):
    at = (0.3, 0.4)
    swinging = one_soft_joint(tmp_path) if soft == 1 else arm(tmp_path, "planar", at=at)
    unsure = Uncertainty(servo_feed_forward=0.98)
    box = ParameterBox(unsure, swinging.robot)
    for half in (0.2, 0.13):
        command, plan = (make((3.0, -4.0), half, at) for make in (bang, there_and_stop))
        arms = [box.departure(each) for each in box.alike_corners()]
        members = [Member(command=command, departure=each) for each in arms]
        many = UncertainArms(swinging, plan, worst=unsure.worst_servo(Servo()))
        own = many.simulate(members)
        with monkeypatch.context() as patch:
            patch.setattr(native, "loaded", lambda: None)
            slow = many.simulate(members)
        scale = np.abs(slow.position).max()
        np.testing.assert_allclose(own.position, slow.position, atol=1e-10 * scale)


@pytest.mark.parametrize("n", [1, 2, 6, 7])
def test_compiled_elastic_response_agrees_with_numpy(monkeypatch, n):
    random = np.random.default_rng(n)
    time = 0.002 * np.arange(403)
    grown = 1.0 + 0.3 * np.sin(9.0 * time)[:, None, None]
    root = random.normal(size=(n, n))
    inertia = grown * (root @ root.T + np.eye(n))
    rate = grown * (random.normal(size=(n, n)) + 5.0 * np.eye(n))
    stiffness = grown * (random.normal(size=(n, n)) + 2e4 * np.diag(1.0 + np.arange(n)))
    torque = random.normal(size=(len(time), n, 3))
    torque[:50] = torque[300:, 0] = 0.0
    within = random.normal(size=(len(time) - 1, 2, n))

    def answers():
        response = ElasticResponse(inertia, rate, stiffness, 0.002)
        changed = response.copy()
        changed.change_springs(slice(100, 217), 0.3 * stiffness[100:217])
        return [
            *response(torque),
            *changed(torque[..., 0]),
            *response.moved(np.moveaxis(torque, 2, 0)),
            *changed.pushed(np.array([n - 1, 0, 0]), torque[:, 0].T),
            *changed.driven(torque[..., 0], *torque[:2, :, 1], within),
            *response.free(random.normal(size=(2 * n, 2 * n))),
        ]

    random = np.random.default_rng(0)
    quick = answers()
    monkeypatch.setattr(native, "loaded", lambda: None)
    random = np.random.default_rng(0)
    for one, other in zip(quick, answers(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11 * np.max(np.abs(other)))
