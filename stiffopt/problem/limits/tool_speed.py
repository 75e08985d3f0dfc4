"""Largest speed of the tool."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.declaration import Speed
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.limits.upper_bound import ToolMagnitudeBound

if TYPE_CHECKING:
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.result.assessment import Assessment
    from stiffopt.symbolic import Quantity


class ToolSpeed(ToolMagnitudeBound):
    """Limit on the speed of the tool's point."""

    def vector(self, model: StageModel) -> Quantity:
        """Velocity of the tool [m/s]."""
        return model.tool_velocity

    def magnitude(self, motion: Assessment) -> np.ndarray:
        """Speed of the tool [m/s]."""
        return motion.tool_speed


LIMITS.add(ToolSpeed("tool_speed", Speed, "m/s", "Largest speed of the tool's point [m/s]."))
