"""Largest velocity of every joint."""

from __future__ import annotations

from stiffopt.declaration import JointVelocity
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.limits.joint_magnitude import JointMagnitude

LIMITS.add(
    JointMagnitude(
        "velocity",
        JointVelocity,
        "angular velocity",
        "Largest velocity of each joint [rad/s, m/s]; the robot's own if left out, "
        '"none" for none.',
        order=1,
    )
)
