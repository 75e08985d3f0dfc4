"""Objectives with planned links: tool deviation, residual vibration, error of the commanded arm."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import OBJECTIVES, Objective, ObjectiveKind, TermInputs
from stiffopt.problem.objectives.deflection import ToolDeflection
from stiffopt.problem.stage_terms import (
    WINDUP_SMOOTHING,
    ObjectiveTerms,
    PathRows,
    StaticVariable,
    squared_length,
)
from stiffopt.problem.trajectory import check_arrival, check_link_planning

if TYPE_CHECKING:
    from stiffopt.problem.motor_model import MotorModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment

# Angular frequency of the deviation times the duration, for the scale of its rate.
_RATE_FREQUENCY = 20.0


class ToolDeviation(ToolDeflection):
    """Dynamic deflection with planned links.

    The formula is that of the quasi-static deflection; it is exact for planned links, which have no
    residual vibration.
    """

    plans_links = True
    chosen_for_robustness = True

    def __init__(self) -> None:
        super().__init__(
            "dynamic",
            phrase="deflection that the motors lead",
            description="Deviation of the tool from its static equilibrium at the same motor "
            "position, vibration included: planned for the links, at rest after arrival; "
            "minimised as far as dynamic_deflection.",
        )
        self.name = "tool_deviation"

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """Raise `ProblemError` unless the links can be planned."""
        check_link_planning(problem, self.name, "minimise 'dynamic_deflection'")

    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Add the mean squared rate of the deviation, which excites arms with other springs."""
        own = super().terms(given)
        if not given.problem.chosen_for_robustness:
            return own
        rate = cast("MotorModel", given.model).deviation_rate * (
            given.problem.duration[1] / _RATE_FREQUENCY / given.scale
        )
        first = len(own.integrands)
        return replace(
            own,
            integrands=(*own.integrands, squared_length(rate)),
            robust_value=lambda integrals, duration: given.scale * integrals[first] / duration,
        )


OBJECTIVES.add(ToolDeviation())


class ShapedDeviation(ToolDeviation):
    """Dynamic deflection with planned links and input shaping.

    `stiffopt.solver.input_shaping` averages the quasi-static optimum of a shorter
    duration over a period of the lowest mode.
    """

    shaped = True
    chosen_for_robustness = False

    def __init__(self) -> None:
        super().__init__()
        self.name = "shaped_deviation"
        self.phrase = "deflection that the motors lead, shaped"
        self.description = (
            "As tool_deviation, with the motion averaged over a period of the lowest mode (input "
            "shaping): somewhat more on the nominal arm, least with model errors; fixed duration."
        )

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """Check as `tool_deviation`; the objective must be alone and the duration fixed."""
        super().check(objective, problem)
        if problem.duration[0] != problem.duration[1] or len(problem.objectives) > 1:
            raise ProblemError(
                "shaped_deviation needs a fixed duration and no other objective; minimise "
                "'tool_deviation', or fix the duration."
            )


OBJECTIVES.add(ShapedDeviation())


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


# Worst error in flight over the root of the summed squares of all parameters at their bounds: of
# plans and rivals 1.4 to 1.6. The servo's lateness, which may be most of the error, adds to that of
# the others: in the same root they would hardly count beside it (decision 0075).
_WORST_OVER_ROOT = 1.5
# Errors below this share of the typical one are smoothed: the root's curvature at zero slows IPOPT.
_SMALL_ERROR_SHARE = 1e-2
# Weight of the squared ringing over the typical error. How large the true error after arrival is
# beside this ringing differs by a factor of ten among arms: `solver.ringing` changes the weight.
_RINGING_WEIGHT = 600.0


class CommandedToolError(ObjectiveKind):
    """Bound of the tool error of the commanded arm over its uncertainty.

    The optimiser bounds the quasi-static error in flight and adds the ringing; the value is that of
    the simulated worst arms.
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
        """Upper bound of the error in flight [m]."""
        return (
            StaticVariable(
                name="tool error in flight",
                start=lambda motion: np.inf if motion.led is None else motion.led.in_flight,
            ),
        )

    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Upper bound of the error in flight, and the squared ringing."""
        (bound,) = given.statics
        motors = cast("MotorModel", given.model)
        error = motors.commanded_error(given.problem.uncertainty, given.problem.servo)
        share = (_WORST_OVER_ROOT / given.scale) ** 2
        squares = error.lateness / given.scale**2, share * error.quasi_static
        worst = sum((each + _SMALL_ERROR_SHARE**2) ** 0.5 for each in squares)
        square = worst**2 - (bound / given.scale) ** 2
        weight = _RINGING_WEIGHT * given.scale
        return ObjectiveTerms(
            value=lambda integrals, duration: bound + weight * integrals[0],
            integrands=(share * error.ringing_rate,),
            path_rows=(PathRows(name="tool error", labels=("tool",), expressions=(square,)),),
            robust_value=lambda integrals, duration: bound + 2.0 * weight * integrals[0],
        )

    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Sum of the worst errors in flight and after arrival [m]; infinite where unknown."""
        return np.inf if motion.led is None else motion.led.whole


OBJECTIVES.add(CommandedToolError())
