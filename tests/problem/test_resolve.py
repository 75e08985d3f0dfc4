"""Inverse kinematics of given poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_arms import load

from stiffopt import Target
from stiffopt.errors import ProblemError
from stiffopt.problem.resolve import resolve


def test_pose_is_found_for_joints_without_limits(tmp_path):
    """Whose middle is none: warnings are errors here."""
    problem = load(tmp_path)
    lower, upper = np.array([-np.inf, -np.inf]), np.array([np.inf, 2.0])
    problem = replace(
        problem,
        start=Target(position=[0.5, 0.0, 0.2]),
        limits=replace(problem.active_limits, position_lower=lower, position_upper=upper),
    )
    motion = resolve(problem)
    bodies = problem.robot.rigid_bodies()
    place, _ = bodies.pose(problem.robot.tool, motion.start)
    assert np.allclose(place, [0.5, 0.0, 0.2], atol=1e-6)


@pytest.mark.parametrize("speed", [0.0, 0.1])
def test_a_stated_velocity_of_zero_is_rest(tmp_path, speed):
    """A pose that takes more torque to hold than allowed can only be passed in motion."""
    ends = f"boundary_velocity = {{ start = [{speed}], end = [{speed}] }}"
    problem = load(tmp_path, "pendulum", motion=ends, limits="torque = [0.5]")
    assert problem.rests_at_both_ends == (speed == 0.0)
    if speed:
        resolve(problem)
    else:
        with pytest.raises(ProblemError, match="holding this pose takes"):
            resolve(problem)
