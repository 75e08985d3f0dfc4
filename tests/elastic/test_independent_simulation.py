"""Simulation against an independent one, for prismatic and rigid joints."""

from __future__ import annotations

import importlib
from dataclasses import dataclass

import numpy as np
import pytest
from small_arms import CONSTANT, ROOT, joint, write_robot

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.robot.files import load_robot

# It swings at 23 Hz: the benchmark looks once in a millisecond, which misses 0.3 % of a peak.
TURN = joint("arm", CONSTANT.format(stiffness=1e3))
START, WAY, DURATION = np.array([0.0, -0.6]), np.array([0.4, 0.5]), 0.2


@dataclass(frozen=True)
class Cycloid:
    """From rest to rest, acceleration without a jump."""

    way: np.ndarray
    duration: float = DURATION

    def __call__(self, t, order):
        s = 2.0 * np.pi * np.asarray(t, dtype=float)[:, None] / self.duration
        rate = 2.0 * np.pi / self.duration
        if order == 0:
            return START + self.way * (s - np.sin(s)) / (2.0 * np.pi)
        if order == 1:
            return self.way * (1.0 - np.cos(s)) / self.duration
        return self.way * np.sin(s) * rate / self.duration


@pytest.fixture
def independent(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    module = importlib.import_module("elastic_simulation")
    # Two periods: the first peaks are the largest.
    monkeypatch.setattr(module, "REST", 0.1)
    return module


def slide(folder, rail, turn=TURN):
    return load_robot(write_robot(folder, "slide", joints=[rail, turn]))


def both(independent, robot, motion):
    """Peaks in flight and after arrival [m] by the package and by the benchmark."""
    times = np.linspace(0.0, motion.duration, 401)
    command = MotorMotion(times, motion(times, 0), motion(times, 1))
    own = simulate(ElasticArm(robot, START), command)
    other = independent.simulate(robot, motion)
    return (own.peak, own.peak_after), (other.peak, other.residual)


RAILS = {
    "rigid": joint("rail", "", torque_max=200.0),
    "sprung": joint("rail", CONSTANT.format(stiffness=1e5), torque_max=200.0),
}


@pytest.mark.parametrize("rail", RAILS)
def test_prismatic_and_revolute_joint_agree_with_independent_simulation(
    tmp_path, independent, rail
):
    own, other = both(independent, slide(tmp_path, RAILS[rail]), Cycloid(WAY))
    assert other == pytest.approx(own, rel=0.01)
    assert min(other) > 1e-6


def test_rigid_prismatic_joint_excites_the_arm_on_it(tmp_path, independent):
    robot = slide(tmp_path, RAILS["rigid"])
    # The turn's motor stands still: all that the tool deviates is from the slide's push.
    found = independent.simulate(robot, Cycloid(WAY * [1.0, 0.0]))
    force = 0.2 * np.abs(2.0 * np.pi * WAY[0] / DURATION**2 * np.sin(START[1]))
    # As a slow push bends it; one so fast bends it by up to twice as much.
    assert 0.4 * force / 1e3 < found.peak < 2.0 * 0.4 * force / 1e3


def test_rigid_arm_has_no_deviation_in_independent_simulation(tmp_path, independent):
    robot = slide(tmp_path, RAILS["rigid"], joint("arm", ""))
    found = independent.simulate(robot, Cycloid(WAY))
    assert (found.peak, found.residual) == pytest.approx((0.0, 0.0), abs=1e-12)
