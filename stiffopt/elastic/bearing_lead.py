"""Lead of the joints against the yielding of elastic bearings, quasi-static.

A bearing has no motor: the driven joints move the tool back onto its path, in all directions that
they reach, so that six joints correct position and orientation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.robot.batched_kinematics import tool_jacobians
from stiffopt.robot.bearing_deflection import correcting_joints, dynamic_bearing_deflections

if TYPE_CHECKING:
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.result.trajectory import JointMotion, Trajectory

# Knot spacing of the lead [s]: slow beside the bearings' modes, for which it does not account. With
# 10 ms a quintic motion of the ER3A rings three times as much after arrival, with 40 ms an arm
# that moves for 0.5 s keeps half of the deflection.
_KNOT_SPACING = 0.02


def bearing_lead(arm: ElasticArm, plan: JointMotion) -> Trajectory:
    """Return the motion of the joints that leads the tool against the yielding of the bearings.

    Parameters
    ----------
    arm : ElasticArm
    plan : JointMotion
        Of the links, at rest at both ends.
    """
    return smooth_motion(_BearingLead(arm, plan), _KNOT_SPACING)


class LedPlan:
    """Motion of the links that leads a plan, at the same times."""

    def __init__(self, plan: JointMotion, lead: JointMotion) -> None:
        self.duration, self._plan, self._lead = plan.duration, plan, lead

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Evaluate position (order 0) or a derivative (K, n) at times (K,)."""
        return np.asarray(self._plan(t, order) + self._lead(t, order))


def uncorrected_deflection(arm: ElasticArm, plan: JointMotion, time: np.ndarray) -> np.ndarray:
    """Displacement (K, 3) [m] of the tool by the bearings that no joint corrects."""
    away, lead = _deflection_and_lead(arm, plan, time)
    _, jacobian = tool_jacobians(arm.robot.tree, arm.robot.tool, plan(time))
    return np.asarray(away[:, :3] + np.einsum("kxj,kj->kx", jacobian, lead))


def _deflection_and_lead(
    arm: ElasticArm, plan: JointMotion, time: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Deflection (K, 6) of the tool by the bearings beyond their sag, and the lead (K, n) [rad]."""
    q, v, a = (np.array(plan(time, k)) for k in range(3))
    # Ends are at rest, where the sag is calibrated away.
    v[[0, -1]] = a[[0, -1]] = 0.0
    force = None if arm.path_force is None else arm.path_force(time)
    away = dynamic_bearing_deflections(arm.robot, q, v, a, arm.process_force, force).sum(axis=1)
    return away, correcting_joints(arm.robot, q, away)


class _BearingLead:
    """Lead at any time, without derivatives."""

    def __init__(self, arm: ElasticArm, plan: JointMotion) -> None:
        self.duration, self._arm, self._plan = plan.duration, arm, plan

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        assert order == 0
        return _deflection_and_lead(self._arm, self._plan, t)[1]
