"""Sources of the tool error of a commanded motion, and the floor of the geometry beside them.

Tolerances of the geometry are the same for every motion to the same poses, and no command leads
them: they are no part of the objective, but the floor below which it gains nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.budget.budget import POSITION, ErrorBudget
from stiffopt.budget.sources import States, ToolJacobians, geometric_sources
from stiffopt.formatting import listed

if TYPE_CHECKING:
    from stiffopt.result.solution import Solution
    from stiffopt.robot.robot import Robot
    from stiffopt.robot.tolerances import Tolerances

# Instants at which the geometry is evaluated.
_INSTANT_COUNT = 31
# Shares below this are not named.
_MIN_NAMED_SHARE = 0.005


def geometry_floor(robot: Robot, tolerances: Tolerances, position: np.ndarray) -> float:
    """Largest 95 % bound of the tool position by geometry and temperature in poses (K, n) [m]."""
    tool = ToolJacobians(robot, position)
    sources = list(geometric_sources(tool, tolerances))
    if tolerances.reference == "start":
        sources = [replace(each, effect=each.effect - each.effect[:1]) for each in sources]
    if not sources:
        return 0.0
    found = ErrorBudget(
        states=States.at_rest(position), place=tool.place, sources=tuple(sources), known=()
    )
    return float(np.max(found.bound(POSITION)))


def error_floor_note(robot: Robot, tolerances: Tolerances, solution: Solution) -> str:
    """Describe what bounds the error of a commanded motion; "" where there is no command."""
    motion, led = solution.assessment, solution.compensation
    if motion is None or motion.led is None or led is None or led.command is None:
        return ""
    chosen = np.linspace(0, len(motion.time) - 1, _INSTANT_COUNT).round().astype(int)
    floor = geometry_floor(robot, tolerances, motion.position[chosen])
    named = listed(
        [
            f"{kind} {100.0 * share:.0f} %"
            for kind, share in sorted(motion.led.shares.items(), key=lambda each: -each[1])
            if share >= _MIN_NAMED_SHARE
        ]
    )
    return (
        f"Sources of the worst arm's error in flight: {named}. Tolerances of the geometry add up to"
        f" {1e3 * floor:.3g} mm (95 %), which no plan or command changes: stiffopt budget names the"
        " measurement that narrows them."
    )
