"""The servo against an independent integration, its inverse and its limit of stability."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from elastic_arms import arm, bang
from runge_kutta import integrate

from stiffopt.baseline.rivals import quintic_law
from stiffopt.elastic import servo as servo_module
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import SERVO_KINDS, Servo
from stiffopt.elastic.simulate import simulate
from stiffopt.errors import InputError
from stiffopt.result.trajectory import ForceHistory, Trajectory

RAMP = MotorMotion(
    np.linspace(0.0, 1.0, 201), np.linspace(0.0, 2.0, 201)[:, None], np.full((201, 1), 2.0)
)


def integrate_servo(servo, command, end, step=2e-5):
    """Motor positions by the classical Runge-Kutta method, without dead time."""
    gain = 2.0 * np.pi * servo.bandwidth
    inner = 5.0 * gain

    def slope(t, state):
        wanted, rate, bend = (command(np.array([t]), k)[0, 0] for k in range(3))
        drive = servo.feed_forward * rate + gain * (wanted - state[0]) - state[1]
        return np.array([state[1], inner * drive + servo.torque_feed_forward * bend])

    return integrate(slope, np.zeros(2), end, step)


def smooth(angle=1.0, duration=0.4):
    """Quintic motion of one joint."""
    law = quintic_law(duration)
    scaled = law.acceleration * angle
    return Trajectory.from_acceleration(law.times, scaled, [0.0], [0.0])


@pytest.mark.parametrize("numbers", [(5.0, 0.0, 0.0, 0.0), (20.0, 0.9, 0.0, 0.7)])
def test_response_agrees_with_an_independent_integration(numbers):
    servo, command = Servo(*numbers), MotorMotion.of(smooth())
    followed = servo.follow(command, 0.5)
    times, expected = integrate_servo(servo, command, 0.4)
    lag = np.abs(expected - command.position(times)[:, 0]).max()
    assert lag > 1e-3
    np.testing.assert_allclose(followed.position(times)[:, 0], expected, rtol=0, atol=2e-5 * lag)


def test_lag_of_a_ramp_is_the_velocity_not_fed_forward_over_the_gain():
    servo = Servo(20.0, 0.9, 0.0, 0.5)
    time = np.array([0.9])
    lag = RAMP.position(time) - servo.follow(RAMP, 1.0).position(time)
    assert lag[0, 0] == pytest.approx(0.1 * 2.0 / (2.0 * np.pi * 20.0), rel=1e-4)


def test_full_feed_forward_without_delay_follows_exactly(tmp_path):
    motion = bang([40.0], 0.0973, [0.0])
    swivel = arm(tmp_path)
    plain, servo = simulate(swivel, motion), simulate(swivel, motion, servo=Servo(20.0))
    np.testing.assert_allclose(servo.deviation, plain.deviation, atol=3e-7)
    assert plain.peak > 2e-4
    lagging = simulate(swivel, motion, servo=Servo(20.0, feed_forward=0.5))
    assert lagging.peak > 10.0 * plain.peak


@pytest.mark.parametrize(
    "servo",
    [
        Servo(15.0, 0.9, 2e-3, 0.8, 250.0),
        Servo(20.0, 1.0, 0.0, 0.9, 125.0),
        Servo(30.0, 0.95, 4e-3, 0.0),
    ],
)
def test_known_lag_and_dead_time_are_led_by_the_command(servo):
    plan = smooth()
    times = np.linspace(0.0, 0.6, 301)
    wanted = MotorMotion.of(plan).position(times)
    led = MotorMotion.of(servo.lead(plan))
    found = servo.follow(led, 0.6, ahead=servo.dead_time).position(times)
    plain = servo.follow(MotorMotion.of(plan), 0.6, ahead=servo.dead_time).position(times)
    assert np.abs(found - wanted).max() < 0.03 * np.abs(plain - wanted).max()
    np.testing.assert_allclose(led(np.array([led.time[-1]])), [[1.0]], atol=1e-5)


@pytest.mark.parametrize("numbers", [(20.0, 0.9, 0.0, 0.5), (15.0, 0.9, 2.1e-3, 0.8, 250.0)])
def test_response_in_blocks_is_that_of_one(numbers, monkeypatch):
    command = MotorMotion.of(smooth())
    whole = Servo(*numbers).follow(command, 0.5, ahead=1e-3)
    wholly_led = Servo(*numbers).lead(smooth())
    monkeypatch.setattr(servo_module, "_STEPS_AT_ONCE", 7)
    parts = Servo(*numbers).follow(command, 0.5, ahead=1e-3)
    monkeypatch.setattr(servo_module, "_STEPS_AT_ONCE", 32)
    led = Servo(*numbers).lead(smooth())
    assert led.duration == wholly_led.duration
    for order in range(4):
        found, expected = (each(led.times, order) for each in (led, wholly_led))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    for order in (0, 1):
        found, expected = (each(whole.time, order) for each in (parts, whole))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_every_kind_of_controller_lags():
    plan = MotorMotion.of(smooth())
    for kind in SERVO_KINDS:
        servo = Servo(kind=kind)
        found = servo.follow(plan, 0.4, ahead=servo.dead_time)
        lag = np.abs(found.position(plan.time) - plan.position(plan.time)).max()
        assert bool(lag > 1e-6) is (kind != "ideal")


def test_a_long_delay_rings():
    motion = bang([4000.0], 0.01, [0.0])
    largest = 0.0091
    near = Servo(20.0, feed_forward=0.0, delay=0.95 * largest).follow(motion, 1.2)
    calm = Servo(20.0, feed_forward=0.0, delay=0.1 * largest).follow(motion, 1.2)
    end = motion.position(np.array([1.0]))[0, 0]
    assert near.position(np.linspace(0.0, 1.2, 500)).max() > 1.2 * end
    assert calm.position(np.linspace(0.0, 1.2, 500)).max() < 1.01 * end
    assert calm.position(np.array([1.2]))[0, 0] == pytest.approx(end, rel=1e-3)


@pytest.mark.parametrize(
    ("numbers", "what"),
    [
        ((20.0, 1.0, 0.0126), "unstable: a position loop of 20 Hz needs a delay below 11.17 ms"),
        ((0.0, 1.0, 0.0), "bandwidth must be above 0"),
        ((20.0, 1.5, 0.0), "share from 0 to 1"),
        ((20.0, 1.0, -1e-3), "0 s or above"),
    ],
)
def test_invalid_servos_are_refused(numbers, what):
    with pytest.raises(InputError, match=what):
        Servo(*numbers)


def test_command_that_leads_the_servo_is_under_the_force_of_its_motion():
    plan = smooth()
    force = ForceHistory(np.array([0.0, 0.6]), np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]))
    led = Servo(kind="industrial").lead(replace(plan, force=force))
    assert led.duration > plan.duration
    assert led.link.force is force
