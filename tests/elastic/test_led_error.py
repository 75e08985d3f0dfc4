"""Error of an ideal command on the worst arms against commands that were made and simulated."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from small_arms import CONSTANT, joint, write_robot

from stiffopt.baseline.rivals import quintic_law
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.led_error import led_error
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import ParameterBox, Uncertainty
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
    led, worst = unsure.led_servo(SERVO), unsure.worst_servo(SERVO)
    many = UncertainArms(elastic, MotorMotion.of(link), SERVO, worst, led.dead_time)
    command, box = MotorMotion.of(led.lead(motors)), ParameterBox(unsure, elastic.robot)
    levels = np.zeros((32, len(box.nominal)))
    levels[:, box.free] = list(product((-1.0, 1.0), repeat=5))
    error = many.simulate([Member(command=command, departure=box.departure(x)) for x in levels])
    found = led_error(elastic, link, unsure, SERVO)
    for own, phase, kind in (
        (found.in_flight, error.flight, "position"),
        (found.after_arrival, error.after, "position"),
        (found.across, error.flight, "across"),
    ):
        assert own == pytest.approx(error.peaks(phase)[kind].max(), rel=0.03)
    assert list(found.shares) == ["stiffness", "damping", "payload", "servo"]
    assert sum(found.shares.values()) == pytest.approx(1.0)
    assert found.whole == found.in_flight + found.after_arrival


def test_no_uncertainty_leaves_no_error(planned):
    elastic, link = planned
    servo = {"servo_bandwidth": 20.0, "servo_torque_feed_forward": 1.0}
    sure = Uncertainty(stiffness=0.0, damping=0.0, payload=0.0, **servo)
    found = led_error(elastic, link, sure, Servo())
    unsure = led_error(elastic, link, Uncertainty(), Servo())
    # What is not below a bound on the corners is not searched any further.
    corners = led_error(elastic, link, Uncertainty(), Servo(), below=0.0)
    assert 0.5 * unsure.whole < corners.whole <= (1.0 + 1e-12) * unsure.whole
    assert led_error(elastic, link, Uncertainty(), Servo(), 1.01 * unsure.whole) == unsure
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
    led = usual.led_servo(servo)
    many = UncertainArms(elastic, link, servo, usual.worst_servo(servo), led.dead_time)
    motors = MotorLaw(robot).motion(link, 1e-2, elastic.lag(link(np.zeros(1))[0]))
    command = MotorMotion.of(led.lead(motors))
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


@pytest.mark.parametrize(
    ("servo", "worst"),
    [
        (Servo(bandwidth=20.0, feed_forward=0.9, delay=4e-3), {}),
        (Servo(bandwidth=25.0, feed_forward=0.95, delay=2e-3), {"servo_delay": 3e-3}),
    ],
)
def test_command_leads_the_middle_of_the_uncertain_servos(servo, worst):
    """A slow motion is as early behind the nominal servo as it is late behind the worst one."""
    unsure, s = Uncertainty(**worst), np.array([1e-2j])
    led = unsure.led_servo(servo)
    lags = [
        (each.transfer(s) / led.transfer(s) - 1.0)[0] for each in (servo, unsure.worst_servo(servo))
    ]
    whole = (unsure.worst_servo(servo).transfer(s) / servo.transfer(s) - 1.0)[0]
    assert lags[0].imag == pytest.approx(-lags[1].imag, rel=1e-3)
    assert lags[1].imag == pytest.approx(0.5 * whole.imag, rel=1e-3)
    # The error by the acceleration, across a bent path, is halved within a tenth.
    assert lags[1].real == pytest.approx(0.5 * whole.real, rel=0.1)


def test_servo_that_follows_exactly_or_is_certain_is_led_as_it_is():
    exact, late = Servo(), Servo(bandwidth=20.0, feed_forward=0.9, torque_feed_forward=0.9)
    assert Uncertainty().led_servo(exact) is exact
    sure = Uncertainty(servo_bandwidth=20.0, servo_torque_feed_forward=0.9)
    assert sure.led_servo(late) is late
