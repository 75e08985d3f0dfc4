"""The position loop against closed forms, and its limit of stability."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_arms import arm, bang

from stiffopt.elastic.motor import MotorMotion, Servo
from stiffopt.elastic.simulate import simulate
from stiffopt.errors import InputError

RAMP = MotorMotion(
    np.linspace(0.0, 1.0, 201), np.linspace(0.0, 2.0, 201)[:, None], np.full((201, 1), 2.0)
)


def test_lag_of_a_ramp_without_feed_forward_is_that_of_a_first_order_loop():
    rate = 2.0 * np.pi * 5.0
    followed = Servo(5.0, feed_forward=0.0).follow(RAMP, 2.0)
    time = np.linspace(0.0, 1.0, 57)
    lag = 2.0 / rate * (1.0 - np.exp(-rate * time))
    np.testing.assert_allclose(followed.position(time)[:, 0], 2.0 * time - lag, atol=1e-6)
    late = np.linspace(1.0, 2.0, 20)
    rest = 2.0 - lag[-1] * np.exp(-rate * (late - 1.0))
    np.testing.assert_allclose(followed.position(late)[:, 0], rest, atol=2e-5)


def test_full_feed_forward_without_delay_follows_exactly(tmp_path):
    motion = bang([40.0], 0.0973, [0.0])
    swivel = arm(tmp_path)
    plain, servo = simulate(swivel, motion), simulate(swivel, motion, servo=Servo(20.0))
    np.testing.assert_allclose(servo.deviation, plain.deviation, atol=3e-7)
    assert plain.peak > 2e-4
    lagging = simulate(swivel, motion, servo=Servo(20.0, feed_forward=0.5))
    assert lagging.peak > 10.0 * plain.peak


def test_a_delay_shifts_the_motion_and_a_long_one_rings():
    motion = bang([40.0], 0.1, [0.0])
    followed = Servo(20.0, delay=2e-3).follow(motion, 1.2)
    time = np.linspace(0.0, 0.2, 50)
    # With full feed-forward the delayed command is what is followed but for a small error.
    np.testing.assert_allclose(
        followed.position(time + 2e-3)[:, 0], motion.position(time)[:, 0], atol=0.02
    )
    motion = bang([4000.0], 0.01, [0.0])
    near = Servo(20.0, feed_forward=0.0, delay=0.9 / 80.0).follow(motion, 1.2)
    calm = Servo(20.0, feed_forward=0.0, delay=0.2 / 80.0).follow(motion, 1.2)
    end = motion.position(np.array([1.0]))[0, 0]
    assert near.position(np.linspace(0.0, 1.2, 500)).max() > 1.1 * end
    assert calm.position(np.linspace(0.0, 1.2, 500)).max() < 1.001 * end
    assert near.position(np.array([1.2]))[0, 0] == pytest.approx(end, rel=0.1)


@pytest.mark.parametrize(
    ("numbers", "what"),
    [
        ((20.0, 1.0, 0.0126), "unstable: a position loop of 20 Hz needs a delay below 12.5 ms"),
        ((0.0, 1.0, 0.0), "bandwidth must be above 0"),
        ((20.0, 1.5, 0.0), "share from 0 to 1"),
        ((20.0, 1.0, -1e-3), "0 s or above"),
    ],
)
def test_invalid_servos_are_refused(numbers, what):
    with pytest.raises(InputError, match=what):
        Servo(*numbers)
