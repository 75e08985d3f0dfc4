"""Duration of the motion."""

from __future__ import annotations

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import OBJECTIVES, Objective, ObjectiveKind, TermInputs
from stiffopt.problem.stage_terms import ObjectiveTerms
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment


class Duration(ObjectiveKind):
    """Time from start to end."""

    name = "duration"
    unit = "s"
    description = "Time from start to end, within the range that motion.duration gives."
    phrase = "duration"
    ends_motion = True
    comparatives = ("shorter", "longer")
    compared_as_ratio = False

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """Raise `ProblemError` for a fixed duration."""
        if problem.duration[0] == problem.duration[1]:
            raise ProblemError(
                f"The duration is fixed at {problem.duration[0]:g} s, so it cannot be minimised. "
                "Give motion.duration as { lower, upper }, or choose another objective."
            )

    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Duration as the value."""
        return ObjectiveTerms(value=lambda integrals, duration: duration)

    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Duration [s]."""
        return motion.duration


OBJECTIVES.add(Duration())
