"""Deviation of the elastic arm's tool from its static equilibrium, vibration included."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import OBJECTIVES, TermInputs
from stiffopt.problem.objectives.deflection import ToolDeflection
from stiffopt.problem.stage_terms import squared_length
from stiffopt.problem.trajectory import check_link_planning

if TYPE_CHECKING:
    from stiffopt.problem.motor_model import MotorModel
    from stiffopt.problem.objective import Objective
    from stiffopt.problem.stage_terms import ObjectiveTerms
    from stiffopt.problem.trajectory import TrajectoryProblem


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
