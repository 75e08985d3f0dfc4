"""Error bounds over a work volume: a box around the tool's motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stiffopt.budget.budget import ErrorBudget, ErrorModel, error_budget
from stiffopt.budget.sources import States
from stiffopt.dynamics.inverse_kinematics import UnreachablePoseError, solve_pose

# Points of the box along each axis.
_GRID_POINTS = 5
# Of the inverse kinematics: from the nearest pose of the motion, few others.
_MAX_RESTARTS = 3
# Change of the tool's position that a bound does not notice.
_POSITION_TOLERANCE = 1e-7


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeBudget:
    """Error budget at rest over a box."""

    budget: ErrorBudget  # of the points that the tool reaches
    unreached: np.ndarray  # (m, 3) other points [m]


def volume_budget(model: ErrorModel, motion: ErrorBudget, margin: float) -> VolumeBudget:
    """Return the budget at rest over the box of a motion and a margin around it.

    The tool has the orientation of the nearest point of the motion, the joints are near those.
    `margin` [m].
    """
    low, high = motion.place.min(axis=0) - margin, motion.place.max(axis=0) + margin
    axes = [np.linspace(a, b, _GRID_POINTS) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    bodies, tool = model.robot.rigid_bodies(), model.robot.tool
    # The first state is the reference of errors relative to the start.
    poses, unreached = [motion.states.position[0]], []
    for point in points:
        nearest = int(np.argmin(np.linalg.norm(motion.place - point, axis=1)))
        near = motion.states.position[nearest]
        rotation = bodies.pose(tool, near)[1]
        try:
            poses.append(
                solve_pose(
                    model.robot,
                    point,
                    rotation,
                    near,
                    restarts=_MAX_RESTARTS,
                    tolerance=_POSITION_TOLERANCE,
                )
            )
        except UnreachablePoseError:
            unreached.append(point)
    whole = error_budget(model, States.at_rest(np.array(poses)))
    return VolumeBudget(budget=_without_first(whole), unreached=np.array(unreached).reshape(-1, 3))


def _without_first(budget: ErrorBudget) -> ErrorBudget:
    states = budget.states
    return ErrorBudget(
        states=replace(states, **{name: array[1:] for name, array in vars(states).items()}),
        place=budget.place[1:],
        sources=tuple(replace(each, effect=each.effect[1:]) for each in budget.sources),
        known=tuple(replace(each, effect=each.effect[1:]) for each in budget.known),
    )
