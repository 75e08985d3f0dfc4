"""Largest deflection of the tool over the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.declaration import Length
from stiffopt.errors import ProblemError
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.limits.upper_bound import ToolMagnitudeBound
from stiffopt.problem.rest_poses import rest_deflection, rest_poses
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING

if TYPE_CHECKING:
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.symbolic import Quantity


class DeflectionCap(ToolMagnitudeBound):
    """Limit on the peak of one part of the tool's deflection."""

    smoothing = WINDUP_SMOOTHING

    def __init__(self, part: str, description: str) -> None:
        super().__init__(f"{part}_deflection", Length, "m", description)
        self.part = part

    def vector(self, model: StageModel) -> Quantity:
        """Part of the deflection (3,) [m]."""
        return getattr(model.deflection, self.part)

    def magnitude(self, motion: Assessment) -> np.ndarray:
        """Length of that part [m]."""
        return np.asarray(np.linalg.norm(motion.deflection[self.part], axis=1))

    def check(self, problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
        """Raise `ProblemError` where the static sag of a rest pose exceeds the limit."""
        cap = getattr(problem.active_limits, self.name)
        for pose in rest_poses(problem, motion) if self.part == "total" else ():
            sag = rest_deflection(problem, pose.angles, self.part) if pose.fixed else 0.0
            if sag > cap:
                raise ProblemError(
                    f"limits.total_deflection: the static sag of the {pose.name} pose is "
                    f"{1e3 * sag:.4g} mm, above the limit {1e3 * cap:.4g} mm, whatever the motion. "
                    "Raise the limit, or use limits.dynamic_deflection."
                )


LIMITS.add(
    DeflectionCap(
        "dynamic", "Largest deviation of the tool from the static sag of the same pose [m]."
    )
)
LIMITS.add(
    DeflectionCap("total", "Largest deflection of the tool, sag and process force included [m].")
)
