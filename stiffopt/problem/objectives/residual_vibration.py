"""Peak of the tool's deviation after arrival."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from stiffopt.problem.objective import OBJECTIVES, Objective, ObjectiveKind, TermInputs
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING, ObjectiveTerms
from stiffopt.problem.trajectory import check_arrival, check_link_planning

if TYPE_CHECKING:
    from stiffopt.problem.motor_model import MotorModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment

# Weight of the snap that selects among motions without residual vibration, in units of the
# objective: negligible beside other terms.
_SNAP_WEIGHT = 1e-3
# Angular frequency of a motion times its duration, for the scale of snap.
_SNAP_FREQUENCY = 4.0 * np.pi


class ResidualVibration(ObjectiveKind):
    """Simulated residual vibration of the elastic arm's tool.

    Planned links arrive at rest, so that every motion has no residual vibration on the nominal
    arm. The least snap selects among them: a smooth motion has little content at the elastic modes
    and excites an arm with model errors least.
    """

    name = "residual_vibration"
    unit = "m"
    description = (
        "Peak deviation of the tool after arrival: zero on the nominal arm; among such motions the "
        "one of least link snap, which leaves least on an arm with model errors."
    )
    phrase = "residual vibration of the tool"
    smoothing = WINDUP_SMOOTHING
    plans_links = True
    of_arrival = True
    comparable = False

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """Raise `ProblemError` unless the links can be planned and end at rest."""
        check_link_planning(problem, self.name, "minimise 'dynamic_deflection'")
        check_arrival(problem, self.name)

    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Mean squared snap, scaled by its typical value for each joint."""
        snap = cast("MotorModel", given.model).snap
        speed = given.problem.active_limits.velocity
        # 1 rad/s for joints without a velocity limit.
        typical = (
            np.where(np.isfinite(speed), speed, 1.0)
            * (_SNAP_FREQUENCY / given.problem.duration[0]) ** 3
        )
        total = sum((snap[j] / typical[j]) ** 2 for j in range(given.problem.joints))
        return ObjectiveTerms(
            value=lambda integrals, duration: _SNAP_WEIGHT * given.scale * integrals[0] / duration,
            integrands=(total,),
        )

    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Peak after arrival of the simulated motion [m]."""
        peak = None if motion.simulated is None else motion.simulated.peak_after
        return np.inf if peak is None else peak


OBJECTIVES.add(ResidualVibration())
