"""Largest acceleration of every joint."""

from __future__ import annotations

from stiffopt.declaration import JointAcceleration
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.limits.joint_magnitude import JointMagnitude

LIMITS.add(
    JointMagnitude(
        "acceleration",
        JointAcceleration,
        "angular acceleration",
        "Largest acceleration of each joint [rad/s^2, m/s^2]; the robot's own if left out, "
        '"none" for none.',
        order=2,
    )
)
