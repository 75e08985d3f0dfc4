"""Deviation of the elastic arm's tool from where it would hang, swinging included."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

from stiffopt.problem.objective import OBJECTIVES
from stiffopt.problem.objectives.deflection import ToolDeflection
from stiffopt.problem.stage_terms import squared_length
from stiffopt.problem.trajectory import check_link_planning

if TYPE_CHECKING:
    from stiffopt.problem.motor_model import MotorModel
    from stiffopt.problem.objective import Objective
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.stage_terms import ObjectiveTerms
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.symbolic import Quantity

# Rises and falls of a deviation in a motion, which give its rates their size.
_RATE_FREQUENCY = 20.0


class ToolDeviation(ToolDeflection):
    """Dynamic deflection of a motion planned for the links.

    The formula is that of the quasi-static deflection; on a link motion that the motors can make
    it is exact, and nothing swings on after arrival.
    """

    plans_links = True
    chosen_for_robustness = True

    def __init__(self) -> None:
        super().__init__(
            "dynamic",
            phrase="deviation of the elastic arm's tool",
            description="Deviation of the tool from where it would hang at the same motor "
            "position, with the links' swing: planned for the links, at rest after arrival; "
            "lowered as far as dynamic_deflection.",
        )
        self.name = "tool_deviation"

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """The links' motion has to be one that can be planned."""
        check_link_planning(problem, self.name, "minimise 'dynamic_deflection'")

    def terms(
        self,
        objective: Objective,
        problem: TrajectoryProblem,
        model: StageModel,
        statics: tuple[Quantity, ...],
        scale: float,
    ) -> ObjectiveTerms:
        """Besides, the mean squared rate of the deviation: what swings where springs differ."""
        own = super().terms(objective, problem, model, statics, scale)
        if not problem.chosen_for_robustness:
            return own
        rate = cast("MotorModel", model).deviation_rate * (
            problem.duration[1] / _RATE_FREQUENCY / scale
        )
        first = len(own.integrands)
        return replace(
            own,
            integrands=(*own.integrands, squared_length(rate)),
            robust_value=lambda integrals, duration: scale * integrals[first] / duration,
        )


OBJECTIVES.add(ToolDeviation())
