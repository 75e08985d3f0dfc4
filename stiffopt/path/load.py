"""Problem files whose path's freedom is chosen by the timings of the paths."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.errors import ProblemError
from stiffopt.path.timed_path import timed_motion
from stiffopt.problem import files
from stiffopt.problem.files import LoadedProblem
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.robot.files import load_robot
from stiffopt.robot.robot import Robot


def load_problem(
    path: str | os.PathLike[str],
    changes: Sequence[str] = (),
    *,
    robots: Callable[[str | Path], Robot] = load_robot,
    choice: object = None,
) -> LoadedProblem:
    """Read a trajectory problem file.

    `changes` such as "motion.duration=0.5 s" override entries of the file; `robots` loads the robot
    of a name or file, for callers with a cache; `choice` is that of the freedom of a path, as a
    result keeps it.
    """
    return files.load_problem(path, changes, robots=robots, choice=choice, timing=least_duration)


def least_duration(problem: TrajectoryProblem) -> float:
    """Return the duration [s] of the fastest motion on a problem's path, infinite without one."""
    try:
        found = timed_motion(problem)
    except ProblemError:
        return np.inf
    assessment = None if found is None else found.assessment
    if assessment is None or not assessment.feasible(CERTIFICATE_TOLERANCE):
        return np.inf
    return assessment.duration
