"""Deviation of the elastic arm's tool from where it would hang, swinging included."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import ProblemError
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
        """The motion is free between two poses at rest, with the one transcription it has."""
        moving = problem.boundary_velocity is not None and np.any(problem.boundary_velocity)
        other = "minimise 'dynamic_deflection'."
        if moving or problem.boundary_acceleration != "zero":
            raise ProblemError(
                "tool_deviation needs a motion at rest at both ends: leave boundary_velocity and "
                f"boundary_acceleration out, or {other}"
            )
        if problem.path is not None:
            raise ProblemError(f"tool_deviation cannot be combined with motion.path; {other}")
        if problem.method.transcription != "piecewise_linear_acceleration":
            raise ProblemError(
                "tool_deviation needs the transcription 'piecewise_linear_acceleration', the "
                f"default; leave method.transcription out, or {other}"
            )


OBJECTIVES.add(ToolDeviation())
