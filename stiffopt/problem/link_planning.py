"""Whether the links' motion can be planned, with motors that lead it by the wind-up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import ProblemError

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem


def check_link_planning(problem: TrajectoryProblem, what: str, instead: str) -> None:
    """Raise `ProblemError` unless the motion is free, with the one transcription it has.

    Parameters
    ----------
    problem : TrajectoryProblem
    what : str
        What plans the links, as users write it: "tool_deviation".
    instead : str
        What to do in place of it: "minimise 'dynamic_deflection'".
    """
    if problem.path is not None:
        raise ProblemError(
            f"{what} cannot be combined with motion.path, whose spline has a jump in its third "
            f"derivative: give start, via and end, or {instead}."
        )
    if problem.method.transcription != "piecewise_linear_acceleration":
        raise ProblemError(
            f"{what} needs the transcription 'piecewise_linear_acceleration', the "
            f"default; leave method.transcription out, or {instead}."
        )


def check_arrival(problem: TrajectoryProblem, what: str) -> None:
    """Raise `ProblemError` unless the motion ends at rest and the arm can swing on."""
    if problem.boundary_velocity is not None and np.any(problem.boundary_velocity[1]):
        raise ProblemError(
            f"{what} is about the arm after it has stopped, and the motion ends with a velocity: "
            f"leave boundary_velocity.end out, or leave {what} out."
        )
    if not problem.robot.yields:
        raise ProblemError(
            f"{what} needs a joint that yields, and {problem.robot.name} has no drivetrain: "
            f"describe the joints' elements in the robot file, or leave {what} out."
        )
