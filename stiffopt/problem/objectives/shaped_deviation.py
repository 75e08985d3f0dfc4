"""Deviation of the elastic arm's tool with input shaping to the lowest mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import OBJECTIVES
from stiffopt.problem.objectives.tool_deviation import ToolDeviation

if TYPE_CHECKING:
    from stiffopt.problem.objective import Objective
    from stiffopt.problem.trajectory import TrajectoryProblem


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
        self.phrase = "deviation of the elastic arm's tool, shaped"
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
