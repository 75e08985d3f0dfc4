"""Tool error against closed forms and an independent integration."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_arms import INERTIA, LENGTH, STIFFNESS, arm, bang, there_and_stop
from runge_kutta import integrate

from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.elastic.uncertain_arms import Member, UncertainArms
from stiffopt.elastic.uncertainty import Departure
from stiffopt.result.tool_error import ToolError, path_directions


def integrate_swivel(motor, damping, end, step=2e-5):
    """Angles of one link on a spring by the classical Runge-Kutta method."""

    def slope(t, state):
        motor_angle, motor_rate = (motor(t)[k] for k in range(2))
        torque = STIFFNESS * (motor_angle - state[0]) + damping * (motor_rate - state[1])
        return np.array([state[1], torque / INERTIA])

    return integrate(slope, np.zeros(2), end, step)


def test_error_is_measured_from_the_planned_path_and_not_from_the_motors(tmp_path):
    swivel = arm(tmp_path)
    half, rate = 0.1, 40.0
    plan = bang([rate], half, [0.0])
    # Motors that lead by a tenth of a degree all the way.
    lead = np.deg2rad(0.1)
    time = np.linspace(0.0, 2 * half, 401)
    command = MotorMotion(time, plan.position(time) + lead, plan(time, 1))
    found = simulate(swivel, command, plan=plan)

    def motor(t):
        t = min(t, 2 * half)
        if t < half:
            return 0.5 * rate * t**2, rate * t
        left = 2 * half - t
        return rate * half**2 - 0.5 * rate * left**2, rate * left

    times, link = integrate_swivel(motor, float(swivel.damping[0]), 2 * half)
    wanted = np.array([motor(t)[0] for t in times])
    # The independent link rests at 0; with the lead everything is turned by it.
    expected = 2.0 * LENGTH * np.abs(np.sin(0.5 * (link + lead - wanted)))
    flight = found.error.flight
    at = np.interp(found.time[flight], times, expected)
    np.testing.assert_allclose(found.distance[flight], at, atol=2e-7)
    turned = np.interp(found.time[flight], times, abs(link + lead - wanted))
    np.testing.assert_allclose(found.error.angle[flight], turned, atol=1e-6)
    # The tool moves on a circle: the error lies along it but for the sagitta.
    sagitta = found.peak**2 / (2.0 * LENGTH)
    assert found.error.across[flight].max() == pytest.approx(sagitta, rel=0.1)


def test_lateness_lies_along_the_path_and_a_swerve_across_it():
    time = np.linspace(0.0, 1.0, 101)
    planned = np.stack([time**2, np.zeros(101), np.zeros(101)], axis=1)
    late = planned.copy()
    late[:, 0] -= 0.01 * 2.0 * time
    late[:, 2] += 0.003
    error = ToolError(
        time=time,
        duration=1.0,
        position=late - planned,
        orientation=np.zeros((101, 3)),
        direction=path_directions(planned),
    )
    peaks = error.peaks(error.flight)
    assert error.along[-1] == pytest.approx(-0.02)
    assert peaks["along"] == pytest.approx(0.02)
    assert peaks["across"] == pytest.approx(0.003)
    assert peaks["position"] == pytest.approx(np.hypot(0.02, 0.003))
    assert not error.after.any()


def test_directions_are_kept_at_rest():
    places = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0.0]])
    directions = path_directions(places)
    np.testing.assert_allclose(directions, np.tile([1.0, 0.0, 0.0], (6, 1)))
    assert not path_directions(np.zeros((4, 3))).any()


def test_batch_and_full_simulation_have_the_same_parts(tmp_path):
    elastic = arm(tmp_path, "planar", at=(0.3, 0.4))
    plan = there_and_stop((3.0, -4.0), 0.2, (0.3, 0.4))
    command = MotorMotion.of(plan)
    member = Member(command=command, departure=Departure.none(2))
    many = UncertainArms(elastic, plan).simulate([member])
    full = simulate(elastic, command)
    for phase in ("flight", "after"):
        own = many.peaks(getattr(many, phase))
        for name, peak in full.error.peaks(getattr(full.error, phase)).items():
            assert own[name][0] == pytest.approx(peak, rel=0.03, abs=2e-8)
