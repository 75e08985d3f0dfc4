"""Deviation of the elastic arm's tool by a motion that is shaped to the arm's lowest mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import OBJECTIVES
from stiffopt.problem.objectives.tool_deviation import ToolDeviation

if TYPE_CHECKING:
    from stiffopt.problem.objective import Objective
    from stiffopt.problem.trajectory import TrajectoryProblem


class ShapedDeviation(ToolDeviation):
    """Dynamic deflection of a motion planned for the links and averaged over a swing.

    Made by `stiffopt.solver.shaping`: the quasi-static optimum of a shorter time, averaged.
    """

    shaped = True
    chosen_for_robustness = False

    def __init__(self) -> None:
        super().__init__()
        self.name = "shaped_deviation"
        self.phrase = "deviation of the elastic arm's tool, shaped"
        self.description = (
            "As tool_deviation, of a motion averaged over a swing of the lowest mode: somewhat "
            "more on the arm as modelled, least on one that is not; of fixed duration."
        )

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """As `tool_deviation`, alone and of fixed duration."""
        super().check(objective, problem)
        if problem.duration[0] != problem.duration[1] or len(problem.objectives) > 1:
            raise ProblemError(
                "shaped_deviation needs a fixed duration and no objective beside it; minimise "
                "'tool_deviation', or fix the duration."
            )


OBJECTIVES.add(ShapedDeviation())
