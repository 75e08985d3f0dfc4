"""Inverse kinematics of given poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from small_arms import load

from stiffopt import Target
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
