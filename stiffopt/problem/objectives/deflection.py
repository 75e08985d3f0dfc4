"""Deflection of the tool: the dynamic part, the total, or the part of the process force."""

from __future__ import annotations

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import (
    ACCEPT_ADVICE,
    OBJECTIVES,
    Bound,
    Objective,
    ObjectiveKind,
    TermInputs,
)
from stiffopt.problem.rest_poses import poses_within_limits, rest_deflection, rest_poses
from stiffopt.problem.stage_terms import (
    WINDUP_SMOOTHING,
    IntegralRow,
    ObjectiveTerms,
    PathRows,
    StaticVariable,
    squared_length,
)
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.assessment import Assessment

# Dynamic deflection that is not minimised further [m]: below the repeatability of geared arms, and
# in slow motions less would require detours of the wrist.
_NEGLIGIBLE_DEFLECTION = 5e-6


class ToolDeflection(ObjectiveKind):
    """Peak or root mean square over time of one part of the tool's deflection.

    A peak is minimised through an upper bound on it (epigraph); a root mean square through a bound
    on the integral, so that the Hessian stays sparse. `part`: "dynamic", "total" or "process".
    `pinned_by`: quantity that bounds the peak in a rest pose; "" for none. `instead`: alternative
    to suggest where the peak is at its bound.
    """

    unit = "m"
    measured = True
    smoothing = WINDUP_SMOOTHING

    def __init__(
        self, part: str, *, phrase: str, description: str, pinned_by: str = "", instead: str = ""
    ) -> None:
        self.name = f"{part}_deflection"
        self.deflection_part = part
        self.negligible = _NEGLIGIBLE_DEFLECTION if part == "dynamic" else 0.0
        self.phrase, self.description = phrase, description
        self.pinned_by, self.instead = pinned_by, instead

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """Raise `ProblemError` for process deflection without a process force."""
        if self.deflection_part == "process" and not np.any(problem.process_force):
            raise ProblemError(
                "process_deflection is the deflection that a force on the tool causes, and there "
                "is none. Give tool.process_force, or minimise 'dynamic_deflection'."
            )

    def bounds(
        self, objective: Objective, problem: TrajectoryProblem, motion: ResolvedMotion
    ) -> list[Bound]:
        """Deflection of fixed rest poses, a lower bound of the peak over the motion."""
        # A robot without any drivetrain is refused by the stage model.
        if problem.robot.yields and not problem.robot.tool_yields(_sample_poses(problem, motion)):
            text = (
                f"{self.name} is zero whatever the motion: no elastic joint of "
                f"{problem.robot.name} moves the tool in any pose. Describe the elements of the "
                f"others in the robot file, give tool.offset, or minimise "
                f"'torque_squared'{ACCEPT_ADVICE}"
            )
            return [Bound(self.name, 0.0, text, True)]
        if not self.pinned_by or objective.measure != "peak":
            return []
        values = [
            (rest_deflection(problem, pose.angles, self.deflection_part), pose.name)
            for pose in rest_poses(problem, motion)
            if pose.fixed
        ]
        if not values:
            return []
        value, where = max(values)
        text = (
            f"The peak {self.name.replace('_', ' ')} cannot be below {self.pinned_by} of the "
            f"{where} pose, {1e3 * value:.4g} mm, whatever the motion. Minimise {self.instead}its "
            f"rms{ACCEPT_ADVICE}"
        )
        return [Bound(self.name, value, text, True)]

    def static_variables(
        self, objective: Objective, problem: TrajectoryProblem, sides: np.ndarray
    ) -> tuple[StaticVariable, ...]:
        """Upper bound of the peak or root mean square [m]."""
        return (
            StaticVariable(
                name=f"{objective.measure} {self.deflection_part} deflection",
                start=lambda motion: self.certified_value(objective, motion),
            ),
        )

    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Upper bound as the value, and the row that enforces it."""
        (bound,) = given.statics
        name = f"{self.deflection_part} deflection {given.objective.measure}"
        square = squared_length(getattr(given.model.deflection, self.deflection_part) / given.scale)
        allowed = (bound / given.scale) ** 2
        if given.objective.measure == "peak":
            row = PathRows(name=name, labels=("tool",), expressions=(square - allowed,))
            return ObjectiveTerms(value=lambda integrals, duration: bound, path_rows=(row,))
        mean = IntegralRow(
            name=name,
            label="tool",
            expression=lambda integrals, duration: integrals[0] / duration - allowed,
        )
        return ObjectiveTerms(
            value=lambda integrals, duration: bound,
            integrands=(square,),
            integral_rows=(mean,),
        )

    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Peak or root mean square on the fine grid [m]."""
        return float(getattr(motion.deflection_summary()[self.deflection_part], objective.measure))


def _sample_poses(problem: TrajectoryProblem, motion: ResolvedMotion) -> np.ndarray:
    """Given poses and samples of those that a motion may take (K, n)."""
    if problem.path is None:
        others = poses_within_limits(problem)
    else:
        others = problem.path(np.linspace(0.0, 1.0, 21))
    return np.vstack([motion.points, others])


OBJECTIVES.add(
    ToolDeflection(
        "dynamic",
        phrase="dynamic tool deflection",
        description="Quasi-static deviation of the tool from the static sag of the same pose, "
        "which calibration cannot remove, without vibration of the links; minimised down to 5 um "
        "or a third of the baseline's, whichever is less.",
    )
)
OBJECTIVES.add(
    ToolDeflection(
        "total",
        phrase="total tool deflection",
        description="Deflection of the tool with the static sag and the process force.",
        pinned_by="the static sag",
        instead="'dynamic_deflection' (the part that the motion adds), or ",
    )
)
OBJECTIVES.add(
    ToolDeflection(
        "process",
        phrase="tool deflection under the process force",
        description="Additional deflection of the tool under the process force.",
        pinned_by="the process deflection at rest",
    )
)
