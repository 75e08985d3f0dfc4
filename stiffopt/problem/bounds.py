"""Values that an objective or a limit cannot get past whatever the motion, found before solving.

What pins one objective or limit is in its own file; here is what holds for all: with a free
duration and no upper bound, deflection, torque and compliance fall for ever, and no joint can be
faster than its velocity and acceleration limits.
"""

from __future__ import annotations

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import ACCEPT, Bound, Objective
from stiffopt.problem.resolve import ResolvedMotion
from stiffopt.problem.trajectory import TrajectoryProblem


def find_bounds(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[Bound, ...]:
    """Bounds of all objectives of a problem."""
    alone = len(problem.objectives) == 1
    found: list[Bound] = []
    for objective in problem.objectives:
        if alone and np.isinf(problem.duration[1]) and not objective.kind.ends_motion:
            found.append(_endless(objective))
        found += objective.kind.bounds(objective, problem, motion)
    return tuple(found)


def check_bounds(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[str, ...]:
    """Refuse degenerate objectives and limits that no motion can meet; notes about the rest.

    Raises
    ------
    ProblemError
        With the value that cannot be beaten, its cause and the choices.
    """
    for kind in problem.active_limits.kinds:
        kind.check(problem, motion)
    bounds = find_bounds(problem, motion)
    accepted = {o.name for o in problem.objectives if o.accept_bound}
    refused = [b for b in bounds if b.degenerate and b.objective not in accepted]
    if refused:
        raise ProblemError("\n".join(b.text for b in refused))
    return tuple(b.text.removesuffix(ACCEPT) + "." * b.text.endswith(ACCEPT) for b in bounds)


def shortest_duration(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[float, str]:
    """A duration [s] that no motion can undercut, and the sentence why; (0, "") where none is seen.

    Each joint on its own, from rest to rest: its way, its velocity and its acceleration limit.
    """
    if not (motion.start_fixed and motion.end_fixed) or problem.boundary_velocity is not None:
        return 0.0, ""
    limits = problem.active_limits
    way = np.abs(motion.end - motion.start)
    with np.errstate(divide="ignore", invalid="ignore"):
        ramp = np.where(np.isinf(limits.acceleration), 0.0, limits.velocity / limits.acceleration)
        needed = np.where(
            way <= limits.velocity * ramp,
            2.0 * np.sqrt(way / limits.acceleration),
            way / limits.velocity + ramp,
        )
    needed = np.nan_to_num(needed, nan=0.0)
    j = int(np.argmax(needed))
    unit = "m" if problem.robot.prismatic[j] else "rad"
    return float(needed[j]), (
        f"Joint {j + 1} has to move by {way[j]:.4g} {unit} and needs {needed[j]:.4g} s or more for "
        f"that within its velocity limit {limits.velocity[j]:.4g} {unit}/s and its acceleration "
        f"limit {limits.acceleration[j]:.4g} {unit}/s^2; the duration allows "
        f"{problem.duration[1]:.4g} s."
    )


def _endless(objective: Objective) -> Bound:
    return Bound(
        objective.name,
        np.inf,
        f"{objective.name} with a free duration and no upper bound has no optimum: a slower motion "
        "is always better, down to the value at rest. Give motion.duration an upper bound or a "
        "fixed value, or add the objective 'duration' with a weight.",
        True,
    )
