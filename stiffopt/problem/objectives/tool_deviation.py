"""Deviation of the elastic arm's tool from where it would hang, swinging included."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stiffopt.problem.link_planning import check_links
from stiffopt.problem.objective import OBJECTIVES
from stiffopt.problem.objectives.deflection import ToolDeflection

if TYPE_CHECKING:
    from stiffopt.problem.objective import Objective
    from stiffopt.problem.trajectory import TrajectoryProblem


class ToolDeviation(ToolDeflection):
    """Dynamic deflection of a motion planned for the links.

    The formula is that of the quasi-static deflection; on a link motion that the motors can make
    it is exact, and nothing swings on after arrival.
    """

    plans_links = True

    def __init__(self) -> None:
        super().__init__(
            "dynamic",
            phrase="deviation of the elastic arm's tool",
            description="Deviation of the tool from where it would hang at the same motor "
            "position, with the links' swing: planned for the links, at rest after arrival.",
        )
        self.name = "tool_deviation"

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """The links' motion has to be one that can be planned."""
        check_links(problem, self.name, "minimise 'dynamic_deflection'")


OBJECTIVES.add(ToolDeviation())
