"""Error of an ideal command on the worst arms against commands that were made and simulated."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from small_arms import CONSTANT, joint, write_robot

from stiffopt.baseline.rivals import quintic_law
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import ParameterBox, Uncertainty
from stiffopt.elastic.worst_arms import led_error
from stiffopt.problem.motor_model import MotorLaw
from stiffopt.result.compensation import Spread
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.files import load_robot

SERVO = Servo(bandwidth=20.0, torque_feed_forward=0.9, feed_forward=0.98, delay=1e-3)


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A planar arm of linear springs with a payload, and a smooth plan of 0.3 s."""
    springs = [joint(name, CONSTANT.format(stiffness=1e4)) for name in ("shoulder", "elbow")]
    robot = load_robot(write_robot(tmp_path_factory.mktemp("arm"), "planar", joints=springs))
    robot = robot.with_payload(1.0, (0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3))
    elastic = ElasticArm(robot, np.array([0.3, 0.4]))
    path = JointPath.through(np.array([[0.3, 0.4], [0.8, -0.3]]))
    return elastic, smooth_motion(path.follow(quintic_law(0.3)), 0.01)


def test_error_is_that_of_a_made_command_on_the_worst_of_all_corners(planned):
    elastic, link = planned
    # Bounds whose mean wind-up is hardly above the nominal one, by which the made command leads.
    unsure = Uncertainty(stiffness=0.05, servo_bandwidth=18.0, servo_delay=2e-3)
    motors = MotorLaw(elastic.robot).motion(link, 1e-3, elastic.lag(link(np.zeros(1))[0]))
    many = UncertainArms(elastic, MotorMotion.of(link), SERVO, unsure.worst_servo(SERVO))
    command, box = MotorMotion.of(SERVO.lead(motors)), ParameterBox(unsure, elastic.robot)
    levels = np.zeros((32, len(box.nominal)))
    levels[:, box.free] = list(product((-1.0, 1.0), repeat=5))
    error = many.simulate([Member(command=command, departure=box.departure(x)) for x in levels])
    found = led_error(elastic, link, unsure, SERVO)
    for own, phase in ((found.in_flight, error.flight), (found.after_arrival, error.after)):
        assert own == pytest.approx(error.peaks(phase)["position"].max(), rel=0.03)
    assert list(found.shares) == ["stiffness", "damping", "payload", "servo"]
    assert sum(found.shares.values()) == pytest.approx(1.0)
    assert found.whole == found.in_flight + found.after_arrival


def test_no_uncertainty_leaves_no_error(planned):
    elastic, link = planned
    servo = {"servo_bandwidth": 20.0, "servo_torque_feed_forward": 1.0}
    sure = Uncertainty(stiffness=0.0, damping=0.0, payload=0.0, **servo)
    found = led_error(elastic, link, sure, Servo())
    unsure = led_error(elastic, link, Uncertainty(), Servo())
    assert found.shares == {}
    assert found.in_flight < 1e-2 * unsure.in_flight


def test_bounds_hold_for_sampled_arms_and_are_tight():
    robot = load_robot("er3a_c60").with_payload(1.0, (0.0, 0.0, 0.05), (1e-3, 1e-3, 1e-3))
    path = JointPath.through(
        np.array([[0.4, 0.1, 0.2, 0.0, 0.8, 0.3], [-0.3, 0.4, 0.0, 0.2, 0.6, 0.0]])
    )
    elastic = ElasticArm(robot, path(np.zeros(1))[0])
    link = smooth_motion(path.follow(quintic_law(0.5)), 0.02)
    usual, servo = Uncertainty(), Servo(kind="industrial")
    many = UncertainArms(elastic, link, servo, usual.worst_servo(servo))
    motors = MotorLaw(robot).motion(link, 1e-2, elastic.lag(link(np.zeros(1))[0]))
    command = MotorMotion.of(servo.lead(motors))
    drawn, other = (
        many.simulate(
            [
                Member(command=command, departure=each)
                for each in ParameterBox(replace(usual, **asked), robot).drawn()
            ]
        )
        for asked in ({}, {"draws": 500, "seed": 3})
    )
    found = led_error(elastic, link, usual, servo)
    for phase, worst in ((drawn.flight, found.in_flight), (drawn.after, found.after_arrival)):
        draws = drawn.peaks(phase)["position"]
        spread = Spread(nominal=0.0, worst=0.0, worst_case="", worst_arm={}, draws=draws, parts={})
        peaks = other.peaks(phase)["position"]
        assert np.mean(peaks > spread.bound) <= 0.05
        assert spread.bound <= 1.3 * np.quantile(peaks, 0.95)
        assert peaks.max() < 1.02 * worst
