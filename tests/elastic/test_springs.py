"""Tabulated springs against the exact law, and beyond its end."""

from __future__ import annotations

import numpy as np
import pytest

from stiffopt.elastic.springs import joint_springs
from stiffopt.exact.chain import exact_compliance, exact_windup
from stiffopt.robot.files import load_robot


@pytest.mark.parametrize("name", ["er3a_c60", "er3a_c60_contact", "ur10"])
def test_springs_follow_the_exact_law_both_ways(name):
    robot = load_robot(name)
    share = np.random.default_rng(1).uniform(-1.2, 1.2, 300)
    for chain, spring, largest in zip(
        robot.chains, joint_springs(robot), robot.torque_max, strict=True
    ):
        torque = share * largest
        windup = exact_windup(chain, torque)
        scale = np.abs(windup).max()
        np.testing.assert_allclose(spring.windup(torque), windup, atol=1e-8 * scale)
        np.testing.assert_allclose(spring.torque(windup), torque, atol=1e-8 * largest)
        torques, stiffness = np.transpose([spring.torque_at(w) for w in windup.tolist()])
        np.testing.assert_allclose(torques, torque, atol=1e-8 * largest)
        np.testing.assert_allclose(stiffness, 1.0 / exact_compliance(chain, torque), rtol=1e-5)


def test_spring_is_linear_beyond_slip():
    robot = load_robot("er3a_c60")
    spring = joint_springs(robot)[0]
    reach = spring.torque_reach
    assert robot.torque_max[0] < reach < 1.5 * robot.torque_max[0]
    assert np.isinf(exact_compliance(robot.chains[0], np.array([1.002 * reach]))[0])
    torque = reach * np.array([1.0, 1.5, 2.0, -2.0])
    windup = spring.windup(torque)
    slopes = np.diff(windup[:3]) / np.diff(torque[:3])
    np.testing.assert_allclose(slopes, exact_compliance(robot.chains[0], torque[:1])[0], rtol=1e-6)
    np.testing.assert_allclose(spring.torque(windup), torque, rtol=1e-9)
    assert windup[3] == -windup[2]
