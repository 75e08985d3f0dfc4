"""Bound of the tool error that the command leaves on an uncertain arm."""

from __future__ import annotations

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
from stiffopt.result.tool_error import BOUND_FACTOR, UNIFORM_MEAN_SQUARE

if TYPE_CHECKING:
    from stiffopt.problem.motor_model import MotorModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment

# Weight of the squared ringing over the typical error: ringing of 1/200 of that counts as much as
# the error in flight, and more counts more: rivals with a smooth time law hardly ring.
_RINGING_WEIGHT = 100.0


class CommandedToolError(ObjectiveKind):
    """Bound of the tool error of the commanded arm over its uncertainty.

    The optimiser bounds the quasi-static error in flight and adds the ringing; the value is that of
    the linear propagation along the motion.
    """

    name = "tool_error"
    unit = "m"
    description = (
        "Bound of the tool's position error on uncertain arms with the motors led by the command, "
        "in flight plus after arrival: twice the root mean square over [uncertainty]."
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
        """Upper bound of the error in flight [m]."""
        return (
            StaticVariable(
                name="tool error in flight",
                start=lambda motion: motion.error_bound()[0],
            ),
        )

    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Upper bound of the error in flight, and the squared ringing."""
        (bound,) = given.statics
        motors = cast("MotorModel", given.model)
        error = motors.commanded_error(given.problem.uncertainty, given.problem.servo)
        share = UNIFORM_MEAN_SQUARE * (BOUND_FACTOR / given.scale) ** 2
        square = share * error.quasi_static - (bound / given.scale) ** 2
        return ObjectiveTerms(
            value=lambda integrals, duration: bound + _RINGING_WEIGHT * given.scale * integrals[0],
            integrands=(share * error.ringing_rate,),
            path_rows=(PathRows(name="tool error", labels=("tool",), expressions=(square,)),),
        )

    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Sum of the largest bounds in flight and after arrival [m]."""
        return sum(motion.error_bound())


OBJECTIVES.add(CommandedToolError())
