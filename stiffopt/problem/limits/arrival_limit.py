"""Limits on what the tool does after the motors have stopped, on which the others build."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stiffopt.problem.limits.upper_bound import UpperBound
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING, PathRows
from stiffopt.result.assessment import Violation

if TYPE_CHECKING:
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.simulation import SimulatedMotion


class ArrivalBound(UpperBound):
    """A number at most, of the simulated second after arrival."""

    of_arrival = True
    smoothing = WINDUP_SMOOTHING

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """None: it holds after the motion."""
        return []

    def rest_missing(self, swing: SimulatedMotion) -> Violation:
        """Of a motion that does not end at rest."""
        return Violation(1.0, self.name, None, swing.duration)
