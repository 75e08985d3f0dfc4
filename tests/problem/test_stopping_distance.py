"""Distance that a moving joint needs to brake, and motions that start too near to a limit."""

import numpy as np
import pytest
from scipy.integrate import quad

from stiffopt.problem.resolve import stopping_distance


def braking_speed(time, speed, acceleration, jerk):
    ramp = min(time, acceleration / jerk)
    return speed - jerk * ramp**2 / 2.0 - jerk * ramp * (time - ramp)


@pytest.mark.parametrize(("speed", "acceleration", "jerk"), [(1.0, 2.0, 5.0), (2.0, 1.0, 50.0)])
def test_distance_is_the_integral_of_the_braking_speed(speed, acceleration, jerk):
    ramp = min(np.sqrt(2.0 * speed / jerk), acceleration / jerk)
    end = ramp + max(braking_speed(ramp, speed, acceleration, jerk), 0.0) / acceleration
    integral = quad(braking_speed, 0.0, end, (speed, acceleration, jerk), points=[ramp])[0]
    found = stopping_distance(np.array([speed]), np.array([acceleration]), np.array([jerk]))
    assert found[0] == pytest.approx(integral, rel=1e-9)


def test_distance_without_limits_is_zero():
    none = np.array([np.inf])
    assert stopping_distance(np.array([3.0]), none, none)[0] == 0.0
    assert stopping_distance(np.array([3.0]), np.array([9.0]), none)[0] == pytest.approx(0.5)
