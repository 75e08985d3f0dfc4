"""Poses that a motion must take and that collide: no motion can cure them."""

from __future__ import annotations

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.resolve import ResolvedMotion
from stiffopt.problem.trajectory import Target, TrajectoryProblem

# Distances are exact to this [m].
_EXACT = 1e-5


def check_clear_poses(problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
    """Raise `ProblemError` where a given pose is nearer to something than the clearance."""
    if not problem.avoids_collisions:
        return
    model, clearance = problem.clearance_model, problem.stated_cell.clearance
    given: list[tuple[str, Target, np.ndarray]] = [
        ("motion.start", problem.start, motion.start),
        *(
            (f"motion.via[{k}]", via, pose)
            for k, (via, pose) in enumerate(zip(problem.vias, motion.vias, strict=True), start=1)
        ),
        ("motion.end", problem.end, motion.end),
    ]
    for where, target, pose in given:
        distance = model.distances(pose)
        k = int(np.argmin(distance))
        if target.fixes_pose and distance[k] < clearance - _EXACT:
            one, other = model.pairs[k]
            raise ProblemError(f"{where}: {_met(one, other, distance[k], clearance)}")


def _met(one: str, other: str, distance: float, clearance: float) -> str:
    advice = (
        f"Choose another pose, correct the place of {other}, or plan all the same with "
        "method.collisions = 'check'."
    )
    if distance < 0.0:
        deep = f"{one} is {-1e3 * distance:.1f} mm deep in {other} there"
        return f"{deep}, so no motion is free of collisions. {advice}"
    return (
        f"{one} is {1e3 * distance:.1f} mm from {other} there, nearer than cell.clearance, "
        f"{1e3 * clearance:.1f} mm. Lower the clearance. {advice}"
    )
