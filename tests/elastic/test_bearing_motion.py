"""Arms with elastic output bearings in motion: simulation, command and uncertainty."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from small_arms import CONSTANT, joint, write_robot
from tilting_arms import simulated_tool, tilting_arm

from stiffopt.baseline.rivals import quintic_law
from stiffopt.drivetrain.bearing import OutputBearing
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.bearings import LedPlan, bearing_lead
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.simulate import simulate
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import Departure, Uncertainty
from stiffopt.elastic.worst_arms import led_error
from stiffopt.problem.motor_model import MotorLaw
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.files import load_robot

_SMOOTHING = 1e-3  # of the motor law
_ENDS = np.array([[0.0, -0.6, 0.4], [0.8, 0.5, 0.2]])
_STIFFNESS = {"waist": 4e4, "shoulder": 3e4, "elbow": 1.5e4}
_MOMENT_STIFFNESS = (3e5, 2.4e5, 1.2e5)  # eight times the torsion, as catalogues state it


@pytest.fixture(scope="module")
def tilting(tmp_path_factory):
    """An arm of three joints with elastic bearings, its plan of 0.5 s, and two commands.

    The first leads the links by the wind-up, the second the tool by the tilt as well.
    """
    springs = [joint(name, CONSTANT.format(stiffness=k)) for name, k in _STIFFNESS.items()]
    robot = load_robot(write_robot(tmp_path_factory.mktemp("arm"), "spatial", joints=springs))
    robot = robot.with_payload(2.0, (0.05, 0.1, 0.0), (1e-3, 1e-3, 1e-3))
    robot = replace(
        robot,
        bearings=tuple(OutputBearing(moment_stiffness=each) for each in _MOMENT_STIFFNESS),
    )
    arm, plan = ElasticArm(robot, _ENDS[0]), _plan(0.5)
    return arm, plan, _command(arm, plan), _command(arm, _led(arm, plan))


def _plan(duration):
    return smooth_motion(JointPath.through(_ENDS).follow(quintic_law(duration)), 0.01)


def _led(arm, plan):
    return smooth_motion(LedPlan(plan, bearing_lead(arm, plan)), 0.01)


def _command(arm, links):
    return MotorLaw(arm.robot).motion(links, _SMOOTHING, arm.lag(_ENDS[0]))


def _independent_error(arm, plan, command):
    """Tool error (K, 3) in flight of the arm whose bearings are joints of their own."""
    other, times = tilting_arm(arm.robot), np.linspace(0.0, plan.duration, 101)
    poses = simulated_tool(other, arm, MotorMotion.of(command), times)
    resting = arm.static_equilibrium(plan(times))
    still = [other.tool_pose(other.static_position(q, np.zeros(3))) for q in resting]
    moved = [own.translation - at.translation for own, at in zip(poses, still, strict=True)]
    return times, np.array(moved)


def _peak(error):
    return float(np.linalg.norm(error, axis=1).max())


def test_simulated_error_equals_that_of_six_component_joints(tilting):
    arm, plan, command, _ = tilting
    times, expected = _independent_error(arm, plan, command)
    own = simulate(arm, MotorMotion.of(command), plan=MotorMotion.of(plan)).error
    found = np.array([np.interp(times, own.time, each) for each in own.position.T]).T
    assert _peak(found) == pytest.approx(_peak(expected), rel=0.03)
    rigid = replace(arm.robot, bearings=())
    stiff = ElasticArm(rigid, plan(np.zeros(1))[0])
    without = simulate(stiff, MotorMotion.of(command), plan=MotorMotion.of(plan))
    assert without.error.distance[own.flight].max() < 0.2 * _peak(expected)


def test_command_leads_the_tool_against_the_tilt(tilting):
    arm, plan, by_windup, by_tilt = tilting
    before, after = (
        _peak(_independent_error(arm, plan, command)[1]) for command in (by_windup, by_tilt)
    )
    assert after < before / 3.0


def test_batch_of_uncertain_bearings_equals_single_simulations(tilting):
    arm, plan, command, _ = tilting
    motors, wanted = MotorMotion.of(command), MotorMotion.of(plan)
    many = UncertainArms(arm, wanted)
    soft = Departure(stiffness=np.ones(3), bearings=np.array([0.7, 1.2, 0.8]))
    errors = many.simulate([Member(command=motors, departure=soft)])
    alone = simulate(arm.with_departure(soft), motors, plan=wanted).error
    found, expected = errors.position[0][errors.flight], alone.position[alone.flight]
    # The batch leaves out the wrench of the links' small vibration.
    assert _peak(found) == pytest.approx(_peak(expected), rel=0.02)


def test_led_error_is_that_of_the_command_on_the_worst_bearings(tilting):
    arm, plan = tilting[0], _plan(1.0)
    command = MotorMotion.of(_command(arm, _led(arm, plan)))
    servo = {"servo_bandwidth": 20.0, "servo_torque_feed_forward": 1.0}
    unsure = Uncertainty(stiffness=0.0, damping=0.0, payload=0.0, bearing_stiffness=0.1, **servo)
    arms = [
        Departure(stiffness=np.ones(3), bearings=1.0 + 0.1 * np.array(signs))
        for signs in product((-1.0, 1.0), repeat=3)
    ]
    members = [Member(command=command, departure=each) for each in arms]
    errors = UncertainArms(arm, MotorMotion.of(plan)).simulate(members)
    found = led_error(arm, plan, unsure, Servo())
    assert found.shares == {"bearing": 1.0}
    worst = errors.peaks(errors.flight)["position"].max()
    assert found.in_flight == pytest.approx(worst, rel=0.02)
