"""An arm begins at rest under all loads of the first instant, against statics by pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_arms import CONSTANT, joint, write_robot
from tilting_arms import tilting_arm

from stiffopt.drivetrain.bearing import OutputBearing
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import Departure
from stiffopt.result.trajectory import ForceHistory, Trajectory
from stiffopt.robot.files import load_robot

_STIFFNESS = np.array([4e4, 3e4, 1.5e4])
_MOTORS = np.array([0.3, -0.6, 0.5])
_CONSTANT, _ALONG = np.array([20.0, -30.0, 15.0]), np.array([-60.0, 45.0, -80.0])
_DURATION = 0.2


@pytest.fixture(params=[False, True], ids=["joints", "bearings"])
def pushed(request, tmp_path):
    """Arm with a payload, a constant force, and a force along a path that keeps its first value."""
    springs = [
        joint(name, CONSTANT.format(stiffness=k))
        for name, k in zip(("waist", "shoulder", "elbow"), _STIFFNESS, strict=True)
    ]
    robot = load_robot(write_robot(tmp_path, "spatial", joints=springs))
    robot = robot.with_payload(2.0, (0.05, 0.1, 0.0), (1e-3, 1e-3, 1e-3))
    if request.param:
        bearings = tuple(OutputBearing(moment_stiffness=8.0 * k) for k in _STIFFNESS)
        robot = replace(robot, bearings=bearings)
    force = ForceHistory(np.array([0.0, _DURATION]), np.array([_ALONG, _ALONG]))
    return ElasticArm(robot, _MOTORS, _CONSTANT).under(force)


def _tool_at_rest(robot, stiffness, force):
    """Tool position (3,) with the motors held, by pinocchio and a fixed point of its own."""
    other, q = tilting_arm(robot), _MOTORS
    for _ in range(100):
        whole = other.static_position(q, force)
        q = _MOTORS + other.driven_torque(whole, force) / stiffness
    return other.tool_pose(whole).translation


def test_motors_that_stand_still_keep_the_tool_where_all_loads_hold_it(pushed):
    still = np.repeat(_MOTORS[None], 3, axis=0)
    command = MotorMotion(np.linspace(0.0, _DURATION, 3), still, np.zeros_like(still))
    found = simulate(pushed, command).error.position
    held = _tool_at_rest(pushed.robot, _STIFFNESS, _CONSTANT + _ALONG)
    expected = held - _tool_at_rest(pushed.robot, _STIFFNESS, _CONSTANT)
    assert np.linalg.norm(expected) > 1e-4
    # Fast components of bearings are rigid in the simulation; the calibrated path is the statics'.
    np.testing.assert_allclose(found[0], expected, atol=2e-3 * np.linalg.norm(expected))
    np.testing.assert_allclose(found, np.tile(found[0], (len(found), 1)), atol=1e-9)


def test_uncertain_arms_begin_where_all_loads_hold_them(pushed):
    still = np.repeat(_MOTORS[None], 3, axis=0)
    command = MotorMotion(np.linspace(0.0, _DURATION, 3), still, np.zeros_like(still))
    plan = Trajectory.from_acceleration([0.0, _DURATION], np.zeros((1, 1, 3)), _MOTORS, np.zeros(3))
    soft = replace(Departure.none(3), stiffness=np.array([0.8, 0.8, 0.8]))
    members = [Member(command=command, departure=each) for each in (Departure.none(3), soft)]
    swings = UncertainArms(pushed, plan).simulate(members).position
    for factor, found in zip((1.0, 0.8), swings, strict=True):
        held, hanging = (
            _tool_at_rest(pushed.robot, factor * _STIFFNESS, force)
            for force in (_CONSTANT + _ALONG, _CONSTANT)
        )
        size = np.linalg.norm(held - hanging)
        np.testing.assert_allclose(found[0], held - hanging, atol=1e-2 * size)
        np.testing.assert_allclose(found, np.tile(found[0], (len(found), 1)), atol=1e-4 * size)
