"""Lead of the joints against the yielding of elastic bearings, quasi-static.

A bearing has no motor: the driven joints move the tool back onto its path, in all directions that
they reach, so that six joints correct position and orientation.
"""

from __future__ import annotations

import numpy as np

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.result.trajectory import JointMotion, Trajectory
from stiffopt.robot.bearing_deflection import correcting_joints, dynamic_bearing_deflections

# Knot spacing of the lead [s]: slow beside the bearings' modes, for which it does not account. With
# 10 ms a quintic motion of the ER3A rings three times as much after arrival, with 40 ms an arm
# that moves for 0.5 s keeps half of the deflection.
_KNOT_SPACING = 0.02


def bearing_lead(arm: ElasticArm, plan: JointMotion) -> Trajectory:
    """Return the motion of the joints that leads the tool against the yielding of the bearings.

    `plan`: of the links, at rest at both ends.
    """
    return smooth_motion(_BearingLead(arm, plan), _KNOT_SPACING)


class LedPlan:
    """Motion of the links that leads a plan, at the same times."""

    def __init__(self, plan: JointMotion, lead: JointMotion) -> None:
        self.duration, self._plan, self._lead = plan.duration, plan, lead

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Evaluate position (order 0) or a derivative (K, n) at times (K,)."""
        return np.asarray(self._plan(t, order) + self._lead(t, order))


class _BearingLead:
    """Lead at any time, without derivatives."""

    def __init__(self, arm: ElasticArm, plan: JointMotion) -> None:
        self.duration, self._arm, self._plan = plan.duration, arm, plan

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        assert order == 0
        q, v, a = (np.array(self._plan(t, k)) for k in range(3))
        # Ends are at rest, where the sag is calibrated away.
        v[[0, -1]] = a[[0, -1]] = 0.0
        arm, force = self._arm, self._arm.path_force
        beside = None if force is None else force(t)
        away = dynamic_bearing_deflections(arm.robot, q, v, a, arm.process_force, beside)
        return correcting_joints(arm.robot, q, away.sum(axis=1))
