"""Limits on the length of a vector at the tool, on which the others build."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.problem.limit import Limits
from stiffopt.problem.limits.upper_bound import UpperBound
from stiffopt.problem.stage_terms import PathRows, squared_length
from stiffopt.result.assessment import Assessment, Violation

if TYPE_CHECKING:
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.symbolic import Quantity


class ToolMagnitudeBound(UpperBound):
    """|vector| <= limit at every instant."""

    @abstractmethod
    def vector(self, model: StageModel) -> Quantity:
        """What is limited (3,), symbolic."""

    @abstractmethod
    def magnitude(self, motion: Assessment) -> np.ndarray:
        """Its length on the fine grid (K,)."""

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """Squared, so that it is smooth at zero."""
        relative = self.vector(model) / getattr(problem.active_limits, self.name)
        return [
            PathRows(
                name=self.name,
                labels=("tool",),
                expressions=(squared_length(relative),),
                upper=(1.0 - margin) ** 2,
            )
        ]

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """The largest length."""
        series = self.magnitude(motion)
        k = int(np.argmax(series))
        excess = float(series[k] / getattr(limits, self.name) - 1.0)
        return [Violation(excess, self.name, None, float(motion.time[k]))]
