"""Lead of the motors against the process force along a path, quasi-static."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from stiffopt.certificate.assess import joint_windup
from stiffopt.certificate.rigid_body import rigid_body_history
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.result.trajectory import ForceHistory, JointMotion, Trajectory

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Step at which the lead is computed, and knot spacing of its spline [s]: kinks of the stiffness,
# which a force passes, must not bend the command between two rows of its file.
_SAMPLE_STEP, _KNOT_SPACING = 2e-3, 2e-2


def force_lead(robot: Robot, plan: JointMotion, force: ForceHistory) -> Trajectory:
    """Return the additional wind-up under the process force, by which the motors lead."""
    time = np.linspace(0.0, plan.duration, max(50, int(np.ceil(plan.duration / _SAMPLE_STEP))) + 1)
    body = rigid_body_history(robot, *(np.asarray(plan(time, k)) for k in range(3)))
    pushed = np.einsum("kij,ki->kj", body.jacobian, force(time))
    turned = joint_windup(robot, body.link_torque - pushed) - joint_windup(robot, body.link_torque)
    return smooth_motion(_Samples(time, turned), _KNOT_SPACING)


def led_against_force(motors: Trajectory, lead: Trajectory, force: ForceHistory) -> Trajectory:
    """Return motors that lead by a further wind-up, with links under the force."""
    link = motors.link or motors
    added = motors.plus(lead.held_for(motors.duration - lead.duration))
    return replace(added, link=replace(link, force=force))


class _Samples:
    """Motion through samples."""

    def __init__(self, time: np.ndarray, values: np.ndarray) -> None:
        self.duration = float(time[-1])
        self._spline = scipy.interpolate.CubicSpline(time, values, bc_type="clamped")

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        return np.asarray(self._spline(t, order))
