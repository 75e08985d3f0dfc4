"""Linear propagation of uncertain parameters against simulated arms."""

from __future__ import annotations

import numpy as np
import pytest
from small_arms import CONSTANT, joint, write_robot

from stiffopt.baseline.rivals import quintic_law
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.error_propagation import propagate_error
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import (
    Departure,
    Uncertainty,
    departure_at_bounds,
    draw_departures,
)
from stiffopt.problem.motor_model import MotorLaw
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.files import load_robot

SERVO = Servo(bandwidth=20.0, torque_feed_forward=0.9, feed_forward=0.98, delay=1e-3)
# Small enough for the first order.
SLIGHT = Uncertainty(
    stiffness=0.004,
    damping=0.01,
    payload=0.01,
    servo_bandwidth=19.8,
    servo_feed_forward=0.979,
    servo_torque_feed_forward=0.899,
)


@pytest.fixture(scope="module")
def commanded(tmp_path_factory):
    """A planar arm of linear springs, a smooth plan of 0.3 s, and the command that leads it."""
    springs = [joint(name, CONSTANT.format(stiffness=1e4)) for name in ("shoulder", "elbow")]
    folder = tmp_path_factory.mktemp("arm")
    robot = load_robot(write_robot(folder, "planar", joints=springs))
    robot = robot.with_payload(1.0, (0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3))
    elastic = ElasticArm(robot, np.array([0.3, 0.4]))
    path = JointPath.through(np.array([[0.3, 0.4], [0.8, -0.3]]))
    link = smooth_motion(path.follow(quintic_law(0.3)), 0.01)
    motors = MotorLaw(robot).motion(link, 1e-3, elastic.lag(link(np.zeros(1))[0]))
    return elastic, link, motors


def simulated(commanded, uncertainty, departures, servo):
    elastic, link, motors = commanded
    many = UncertainArms(elastic, MotorMotion.of(link), servo, uncertainty.worst_servo(servo))
    command = MotorMotion.of(servo.lead(motors))
    return many.simulate([Member(command=command, departure=each) for each in departures])


def test_shares_are_differences_of_simulated_arms(commanded):
    elastic, link, _ = commanded
    none = np.zeros(2)
    cases = {
        "stiffness of joint 1": (np.array([1.0, 0.0]), 0.0, 0.0, 0.0),
        "stiffness of joint 2": (np.array([0.0, 1.0]), 0.0, 0.0, 0.0),
        "damping": (none, 1.0, 0.0, 0.0),
        "payload": (none, 0.0, 1.0, 0.0),
        "servo": (none, 0.0, 0.0, 1.0),
    }
    arms = [Departure.none(2), *(departure_at_bounds(SLIGHT, *each) for each in cases.values())]
    errors = simulated(commanded, SLIGHT, arms, SERVO)
    found = propagate_error(elastic, link, SLIGHT, SERVO)
    assert list(found.shares) == list(cases)
    largest = np.linalg.norm(errors.position - errors.position[0], axis=2).max()
    for k, (name, share) in enumerate(found.shares.items(), start=1):
        true = errors.position[k] - errors.position[0]
        mean = share.mean(axis=0)
        own = np.stack([np.interp(errors.time, found.time, mean[:, x]) for x in range(3)], axis=1)
        off = np.linalg.norm(own - true, axis=1).max()
        assert off < max(0.02 * np.linalg.norm(true, axis=1).max(), 0.002 * largest), name


def test_bound_in_flight_holds_for_sampled_arms_and_is_tight(tmp_path):
    robot = load_robot("er3a_c60").with_payload(1.0, (0.0, 0.0, 0.05), (1e-3, 1e-3, 1e-3))
    path = JointPath.through(
        np.array([[0.4, 0.1, 0.2, 0.0, 0.8, 0.3], [-0.3, 0.4, 0.0, 0.2, 0.6, 0.0]])
    )
    elastic = ElasticArm(robot, path(np.zeros(1))[0])
    link = smooth_motion(path.follow(quintic_law(0.5)), 0.02)
    motors = MotorLaw(robot).motion(link, 1e-2, elastic.lag(link(np.zeros(1))[0]))
    usual, servo = Uncertainty(draws=200, seed=3), Servo(kind="industrial")
    drawn = draw_departures(usual, 6, True)
    errors = simulated((elastic, link, motors), usual, drawn, servo)
    found = propagate_error(elastic, link, usual, servo)
    peaks = errors.peaks(errors.flight)["position"]
    assert np.mean(peaks > found.in_flight) <= 0.05
    assert found.in_flight <= 1.3 * np.quantile(peaks, 0.95)


def test_no_uncertainty_leaves_no_error(commanded):
    elastic, link, _ = commanded
    sure = Uncertainty(
        stiffness=0.0,
        damping=0.0,
        payload=0.0,
        servo_bandwidth=20.0,
        servo_torque_feed_forward=1.0,
    )
    found = propagate_error(elastic, link, sure, Servo())
    assert found.shares == {}
    assert found.in_flight == found.after_arrival == 0.0
