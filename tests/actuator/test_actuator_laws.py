"""Laws of actuators against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from stiffopt.actuator.cascade import Cascade
from stiffopt.actuator.law import mean_command
from stiffopt.actuator.position_servo import PositionServo
from stiffopt.actuator.voltage_motor import VoltageMotor
from stiffopt.errors import InputError

NO_LIMIT = np.array([np.inf])


def test_position_servo_is_clipped_at_the_largest_torque() -> None:
    law = PositionServo(kind="position_servo", kp=(20.0,), kd=(1.5,)).law(np.array([6.0]))
    error, velocity = np.array([[0.2], [0.5]]), np.array([[1.0], [1.0]])
    np.testing.assert_allclose(law.torque(error, velocity), [[2.5], [6.0]], rtol=1e-12)


def test_cascade_is_a_velocity_loop_around_the_torque() -> None:
    law = Cascade(kind="cascade", position_gain=(12.0,), velocity_gain=(3.0,)).law(NO_LIMIT)
    found = law.torque(np.array([0.1]), np.array([0.7]))
    np.testing.assert_allclose(found, 3.0 * (12.0 * 0.1 - 0.7), rtol=1e-12)


def test_voltage_motor_loses_torque_by_its_back_emf() -> None:
    motor = VoltageMotor(
        kind="voltage_motor",
        gain=(40.0,),
        voltage_max=(12.0,),
        torque_constant=(1.6,),
        resistance=(2.0,),
    )
    # A saturated voltage still gives less torque at speed: the torque-speed line.
    found = motor.law(NO_LIMIT).torque(np.array([[1.0], [0.1]]), np.array([[3.0], [3.0]]))
    np.testing.assert_allclose(found, [[1.6 / 2.0 * (12 - 4.8)], [1.6 / 2.0 * (4 - 4.8)]])


def test_unknown_gain_leaves_the_torque_missing() -> None:
    law = PositionServo(kind="position_servo").law(np.array([6.0]))
    assert not law.known
    assert np.isnan(law.torque(np.array([0.1]), np.array([0.0]))).all()


def test_a_list_of_another_length_is_refused() -> None:
    with pytest.raises(InputError, match="one number a joint"):
        PositionServo(kind="position_servo", kp=(1.0, 2.0)).law(NO_LIMIT)


def test_mean_command_is_the_mean_of_the_held_values_and_has_the_slope_of_a_delay() -> None:
    time, command = np.array([0.0, 0.1, 0.2]), np.array([[1.0], [3.0], [2.0]])
    begin, end = np.array([0.05, 0.15, 0.3]), np.array([0.15, 0.2, 0.4])
    mean, rate = mean_command(time, command, begin, end)
    np.testing.assert_allclose(mean[:, 0], [2.0, 3.0, 2.0])
    step = 1e-6
    moved = mean_command(time, command, begin + step, end + step)[0]
    np.testing.assert_allclose((moved - mean)[:2] / step, rate[:2], rtol=1e-6, atol=1e-6)
