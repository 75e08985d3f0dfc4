"""Poses that a motion must take and that collide: no motion can cure them."""

from __future__ import annotations

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.resolve import ResolvedMotion
from stiffopt.problem.trajectory import Target, TrajectoryProblem

# Distances are exact to this [m].
_DISTANCE_TOLERANCE = 1e-5


def check_clear_poses(problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
    """Raise `ProblemError` where a given pose is nearer to something than the clearance."""
    if not problem.avoids_collisions:
        return
    clearance = problem.stated_cell.clearance
    for where, pose in _fixed_poses(problem, motion):
        distance = problem.clearance_model.distances(pose)
        k = int(np.argmin(distance))
        if distance[k] < clearance - _DISTANCE_TOLERANCE:
            met = _describe_collision(problem, problem.clearance_model.pairs[k], float(distance[k]))
            raise ProblemError(f"{where}: {met}")


def clearance_at_poses(problem: TrajectoryProblem, motion: ResolvedMotion) -> float:
    """The largest clearance that the given poses keep [m]."""
    model = problem.clearance_model
    return min(
        (float(model.distances(q).min()) for _, q in _fixed_poses(problem, motion)), default=np.inf
    )


def _fixed_poses(
    problem: TrajectoryProblem, motion: ResolvedMotion
) -> list[tuple[str, np.ndarray]]:
    """The poses that leave the joints no freedom, and where they stand in files."""
    every = zip(located_targets(problem), (motion.start, *motion.vias, motion.end), strict=True)
    return [(where, pose) for (where, target), pose in every if target.fixes_pose]


def located_targets(problem: TrajectoryProblem) -> list[tuple[str, Target]]:
    """Start, vias and end, and where they stand in files."""
    vias = [(f"motion.via[{k}]", via) for k, via in enumerate(problem.vias, start=1)]
    return [("motion.start", problem.start), *vias, ("motion.end", problem.end)]


def _describe_collision(problem: TrajectoryProblem, pair: tuple[str, str], distance: float) -> str:
    one, other = pair
    choices = ["Choose another pose"]
    if other in problem.stated_cell.names:
        choices.append(f"correct the place of {other}")
    advice = ", ".join([*choices, "or plan all the same with method.collisions = 'check'."])
    if distance < 0.0:
        deep = f"{one} is {-1e3 * distance:.1f} mm deep in {other} there"
        return f"{deep}, so no motion is free of collisions. {advice}"
    clearance = problem.stated_cell.clearance
    return (
        f"{one} is {1e3 * distance:.1f} mm from {other} there, nearer than cell.clearance, "
        f"{1e3 * clearance:.1f} mm. Lower the clearance. {advice}"
    )
