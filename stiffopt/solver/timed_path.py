"""Minimum duration on a fixed path: its fastest timing, certified."""

from __future__ import annotations

import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.objective_value import objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.errors import ProblemError
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.solution import Baseline
from stiffopt.solver.path_timing import PathDemands, fastest_timing

# Limits from which a timing can back off, where the certificate finds an excess between nodes.
_TIMED_LIMITS = ("velocity", "acceleration", "jerk", "torque", "tool_speed")
_MAX_BACK_OFFS = 4
FASTEST_REASON = (
    "on a given path none is faster within limits on velocity, acceleration, drive torque and tool "
    "speed, and none near it within those on jerk. To be faster, change the path or the limits."
)


def timed_motion(problem: TrajectoryProblem) -> Baseline | None:
    """Return the certified fastest motion on the problem's path, not below its least duration.

    None where it exceeds a limit of another kind, or the largest duration.
    """
    path, margins = problem.path, {}
    assert path is not None
    force, shortest = problem.process_force, problem.duration[0]
    for _ in range(_MAX_BACK_OFFS):
        demands = PathDemands(
            process_force=lambda s: np.broadcast_to(force, (len(s), 3)),
            margin=margins,
            eased=problem.boundary_acceleration == "zero",
        )
        try:
            law = fastest_timing(problem.robot, problem.active_limits, path, demands)
        except ProblemError:
            return None
        law = law.scaled_to(shortest) if law.duration < shortest else law
        motion = path.follow(law)
        assessment = assess(problem, motion)
        worst = assessment.worst_violation
        if worst.value <= CERTIFICATE_TOLERANCE:
            break
        if worst.limit not in _TIMED_LIMITS:
            return None
        margins[worst.limit] = 1.0 - (1.0 - margins.get(worst.limit, 0.0)) / (1.0 + worst.value)
    else:
        return None
    if law.duration > problem.duration[1] * (1.0 + 1e-9):
        return None
    assessment = with_collisions(problem, assessment)
    return Baseline(
        name="timed",
        assessment=assessment,
        objective=objective_value(problem, assessment).value,
        feasible=True,
        reason="",
        trajectory=motion,
    )
