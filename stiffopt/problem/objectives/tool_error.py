"""Bound of the tool error that the command leaves on an uncertain arm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import OBJECTIVES, Objective, ObjectiveKind, TermInputs
from stiffopt.problem.stage_terms import (
    WINDUP_SMOOTHING,
    ObjectiveTerms,
    PathRows,
    StaticVariable,
)
from stiffopt.problem.trajectory import check_arrival, check_link_planning

if TYPE_CHECKING:
    from stiffopt.problem.motor_model import MotorModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment

# Worst error in flight over the root of the summed squares of all parameters at their bounds: of
# plans and rivals 1.4 to 1.6. The servo's lateness, which may be most of the error, adds to that of
# the others: in the same root they would hardly count beside it (decision 0075).
_WORST_OVER_ROOT = 1.5
# Errors below this share of the typical one are smoothed: the root's curvature at zero slows IPOPT.
_SMALL_ERROR_SHARE = 1e-2
# Unit and start of the ringing's variable, over the typical error in flight: as large as on most
# arms. In that error itself IPOPT ends at its looser tolerance on the ER3A.
_RINGING_SHARE = 2e-2
# Scale of a motion's error across the path: that in flight over it, of the best baselines.
_ACROSS_RATIO = "tool_error in flight over across"


class CommandedToolError(ObjectiveKind):
    """Bound of the tool error of the commanded arm over its uncertainty.

    The optimiser bounds the quasi-static error in flight and adds the ringing; the value is the sum
    of both phases on the simulated worst arms.
    """

    name = "tool_error"
    unit = "m"
    description = (
        "Tool's position error on the worst arms within [uncertainty] with the motors led by the "
        "command, in flight plus after arrival."
    )
    phrase = "tool error of the commanded arm"
    smoothing = WINDUP_SMOOTHING
    plans_links = True
    of_uncertain_arms = True
    comparable = False

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """Raise `ProblemError` unless there is a command and an uncertainty."""
        check_link_planning(problem, self.name, "minimise 'dynamic_deflection'")
        check_arrival(problem, self.name)
        if not np.any(problem.uncertainty.shares(problem.joints)):
            raise ProblemError(
                f"{self.name} refers to arms of uncertain stiffness, and uncertainty.stiffness is "
                "0: give a share above 0, or minimise 'tool_deviation'."
            )
        if problem.boundary_velocity is not None and np.any(problem.boundary_velocity[0]):
            raise ProblemError(
                f"{self.name} refers to a command from rest, and the motion starts with a "
                "velocity: leave boundary_velocity.start out, or minimise 'tool_deviation'."
            )

    def static_variables(
        self, objective: Objective, problem: TrajectoryProblem, sides: np.ndarray
    ) -> tuple[StaticVariable, ...]:
        """Upper bound of the error in flight [m], and the ringing over the typical error."""
        return (
            StaticVariable(
                name="tool error in flight",
                start=lambda motion: np.inf if motion.led is None else motion.led.in_flight,
            ),
            StaticVariable(
                name="ringing", start=lambda motion: _RINGING_SHARE, scale=_RINGING_SHARE
            ),
        )

    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Sum of the upper bounds of the error in flight and of the ringing."""
        bound, ringing = given.statics
        motors = cast("MotorModel", given.model)
        error = motors.commanded_error(given.problem.uncertainty, given.problem.servo)
        share = (_WORST_OVER_ROOT / given.scale) ** 2
        limit = (bound / given.scale) ** 2
        # As much better than the baselines across the path as in flight.
        across = given.scales.of(_ACROSS_RATIO) ** 2
        squares = {
            "tool": (error.lateness / given.scale**2, share * error.quasi_static),
            "tool across its path": (
                across * error.lateness_across / given.scale**2,
                across * share * error.quasi_static_across,
            ),
        }
        rows = [
            sum((each + _SMALL_ERROR_SHARE**2) ** 0.5 for each in both) ** 2 - limit
            for both in squares.values()
        ]
        return ObjectiveTerms(
            # The root of a square is the least mean of a length and the square over it.
            value=lambda integrals, duration: bound + 0.5 * given.scale * (ringing + integrals[0]),
            integrands=(share * error.ringing_rate / ringing,),
            path_rows=(
                PathRows(name="tool error", labels=tuple(squares), expressions=tuple(rows)),
            ),
        )

    def scales(self, objective: Objective, motions: Sequence[Assessment]) -> dict[str, float]:
        """Return those of every kind, and the least error in flight over the least one across."""
        led = [each.led for each in motions if each.led is not None]
        flight, across = (
            min((getattr(each, name) for each in led), default=0.0)
            for name in ("in_flight", "across")
        )
        ratio = (
            flight / across if across > _SMALL_ERROR_SHARE * flight else 1.0 / _SMALL_ERROR_SHARE
        )
        return super().scales(objective, motions) | ({_ACROSS_RATIO: ratio} if led else {})

    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Sum of the worst errors in flight and after arrival [m]; infinite where unknown."""
        return np.inf if motion.led is None else motion.led.whole


OBJECTIVES.add(CommandedToolError())
