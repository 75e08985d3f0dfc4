"""The quintic baseline: smooth rest-to-rest motion along a joint path, whatever the limits."""

from __future__ import annotations

from stiffopt.baseline.motion import BaselineMotion
from stiffopt.result.joint_path import JointPath
from stiffopt.result.trajectory import Trajectory


def quintic_law(duration: float) -> Trajectory:
    """Time law s(t) = 10 x^3 - 15 x^4 + 6 x^5, x = t/duration.

    Velocity and acceleration vanish at both ends. Peak velocity 15/8 divided by the duration, peak
    acceleration 10/sqrt(3) divided by its square.
    """
    t = duration
    acceleration = [[[0.0], [60.0 / t**3], [-180.0 / t**4], [120.0 / t**5]]]
    return Trajectory.from_acceleration([0.0, t], acceleration, [0.0], [0.0])


def quintic_baseline(path: JointPath, duration: float) -> BaselineMotion:
    """Motion along `path` by the quintic time law; its violations are for the assessment to find.

    Parameters
    ----------
    path : JointPath
    duration : float
        [s]
    """
    return BaselineMotion(name="quintic", motion=path.follow(quintic_law(duration)))
