"""Peak of the tool's deviation after arrival."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from stiffopt.problem.objective import OBJECTIVES, Objective, ObjectiveKind
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING, ObjectiveTerms
from stiffopt.problem.trajectory import check_arrival, check_link_planning

if TYPE_CHECKING:
    from stiffopt.problem.motor_model import MotorModel
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.symbolic import Quantity

# Of the snap that tells motions apart, in units of the objective: it must not count beside others.
_SNAP_WEIGHT = 1e-3
# Of a motion's rises and falls, times its duration.
_SNAP_FREQUENCY = 4.0 * np.pi


class ResidualVibration(ObjectiveKind):
    """What the elastic arm's tool does once the motors stand still, as simulated.

    Links that are planned are at rest then, so that no motion leaves anything on the arm as
    modelled. Of all these the one with the least snap is taken: an arm that is not quite as
    modelled is excited by what a motion holds at its frequencies, and smooth motions hold little.
    """

    name = "residual_vibration"
    unit = "m"
    description = (
        "Peak deviation of the tool after arrival: none as modelled; of such motions that of the "
        "links' least snap, which leaves little on an arm that is not quite as modelled."
    )
    phrase = "residual vibration of the tool"
    smoothing = WINDUP_SMOOTHING
    plans_links = True
    of_arrival = True
    comparable = False

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """The links' motion has to be one that can be planned, and end at rest."""
        check_link_planning(problem, self.name, "minimise 'dynamic_deflection'")
        check_arrival(problem, self.name)

    def terms(
        self,
        objective: Objective,
        problem: TrajectoryProblem,
        model: StageModel,
        statics: tuple[Quantity, ...],
        scale: float,
    ) -> ObjectiveTerms:
        """The mean squared snap, each joint's in units of its typical one."""
        snap = cast("MotorModel", model).snap
        speed = problem.active_limits.velocity
        # Without a limit of velocity one that any joint has: its snap has to count all the same.
        typical = (
            np.where(np.isfinite(speed), speed, 1.0) * (_SNAP_FREQUENCY / problem.duration[0]) ** 3
        )
        total = sum((snap[j] / typical[j]) ** 2 for j in range(problem.joints))
        return ObjectiveTerms(
            value=lambda integrals, duration: _SNAP_WEIGHT * scale * integrals[0] / duration,
            integrands=(total,),
        )

    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Peak after arrival of the simulated motion [m]."""
        peak = None if motion.swing is None else motion.swing.peak_after
        return np.inf if peak is None else peak


OBJECTIVES.add(ResidualVibration())
