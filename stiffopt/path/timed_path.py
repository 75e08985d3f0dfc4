"""Minimum duration on a fixed path: its fastest timing, certified."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.objective_value import objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.errors import ProblemError
from stiffopt.path.averaged_law import averaged_law
from stiffopt.path.limit_shares import BACKED_OFF, LimitShares
from stiffopt.path.path_duty import slowing_within_duty
from stiffopt.path.path_timing import PathDemands, PathTiming
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.duty import DutyLimits
from stiffopt.result.joint_path import JointPath
from stiffopt.result.solution import Baseline
from stiffopt.result.trajectory import ForceHistory, Trajectory, join_motions
from stiffopt.robot.batched_kinematics import tool_jacobians

_MAX_BACK_OFFS = 6
# Windows over which the law of a motion with a command is averaged [s], and the duration over that
# of the fastest law and two windows up to which one is taken.
AVERAGING_WINDOWS, _MAX_SLOWING = (0.04, 0.02, 0.01), 1.1
FASTEST_REASON = (
    "on a given path none is faster within limits on velocity, acceleration, drive torque and tool "
    "speed, and none near it within those on jerk. To be faster, change the path or the limits."
)


def timed_motion(problem: TrajectoryProblem) -> Baseline | None:
    """Return the certified fastest motion on the problem's path, as of `timed_path`."""
    found = timed_path(problem)
    return None if found is None else found[0]


def timed_path(
    problem: TrajectoryProblem, shares: LimitShares | None = None
) -> tuple[Baseline, Trajectory] | None:
    """Return the certified fastest motion on the problem's path, and its time law.

    It is not below the problem's least duration and uses the `shares` of the limits. Where a
    command is asked for, its law is averaged over the widest window that costs little time, so that
    the motors can lead. None where it exceeds a limit of another kind, or the largest duration.
    Raises `ProblemError` where the drives cannot hold the arm on the path, nothing bounds the
    speed, or no allowed duration keeps the limits of the duty.
    """
    path = problem.path
    assert path is not None
    given = LimitShares(AVERAGING_WINDOWS[0]) if shares is None else shares
    own = given

    def share(name: str, s: np.ndarray) -> np.ndarray:
        along = own.of_piece(0)
        return np.ones(len(s)) if along is None else along(name, s)

    demands = PathDemands(
        process_force=_forces_along(problem, path),
        shares=share,
        eased=problem.boundary_acceleration == "zero",
    )
    timing = PathTiming(problem.robot, problem.active_limits, path, demands)
    fastest_laws = timing.laws()

    def timed(window: float) -> tuple[Baseline, Trajectory] | None:
        """Return the certified motion with its law averaged twice over a window [s]."""
        nonlocal own
        own, laws = given.copy(), fastest_laws
        for _ in range(_MAX_BACK_OFFS):
            # Not across a stop, where the path may have a corner that the average would not rest
            # at.
            law = join_motions(
                [(averaged_law(each, window) if window else each, rest) for each, rest in laws]
            )
            shortest = problem.duration[0]
            law = law.scaled_to(shortest) if law.duration < shortest else law
            motion, assessment = _follow(problem, path, law)
            excess = [v for v in assessment.violations if v.value > CERTIFICATE_TOLERANCE]
            if not excess:
                return _certified(problem, path, law, motion, assessment)
            if any(each.limit not in BACKED_OFF for each in excess):
                return None
            own.back_off([(0.0, law)], problem.active_limits, [assessment], excess)
            try:
                laws = timing.laws()
            except ProblemError:  # the share of the torque that is left does not hold the arm
                return None
        return None

    fastest = timed(0.0)
    if fastest is None or not problem.leads_on_path:
        return fastest
    assert fastest[0].objective is not None
    for window in AVERAGING_WINDOWS:
        try:
            found = timed(window)
        except ProblemError:  # no time is left in which its duty, unlike the fastest's, is kept
            continue
        # Every part between stops ends two windows later.
        allowed = _MAX_SLOWING * (fastest[0].objective + 2.0 * window * (1 + len(path.stops)))
        if found is not None and (found[0].objective or np.inf) <= allowed:
            return found
    return fastest


def _certified(
    problem: TrajectoryProblem,
    path: JointPath,
    law: Trajectory,
    motion: Trajectory,
    assessment: Assessment,
) -> tuple[Baseline, Trajectory] | None:
    """Return the motion of a law within the limits of duty and duration, and the law."""
    if law.duration > problem.duration[1] * (1.0 + 1e-9):
        return None
    if problem.duty is not None:
        law = _within_duty(problem, path, law, problem.duty)
        motion, assessment = _follow(problem, path, law)
    assessment = with_collisions(problem, assessment)
    found = Baseline(
        name="timed",
        assessment=assessment,
        objective=objective_value(problem, assessment).value,
        feasible=True,
        reason="",
        trajectory=motion,
    )
    return found, law


def _follow(
    problem: TrajectoryProblem, path: JointPath, law: Trajectory
) -> tuple[Trajectory, Assessment]:
    """Return the motion of a law on the path, and its assessment."""
    motion = replace(path.follow(law), force=_force_history(problem, path, law))
    return motion, assess(problem, motion)


def _within_duty(
    problem: TrajectoryProblem, path: JointPath, law: Trajectory, limits: DutyLimits
) -> Trajectory:
    """Return a law slowed until the duty of its motion keeps the limits."""

    def slowed(factor: float) -> Assessment:
        return _follow(problem, path, law.scaled_to(factor * law.duration))[1]

    most = problem.duration[1] / law.duration
    return law.scaled_to(law.duration * slowing_within_duty(problem.robot, limits, slowed, most))


def _forces_along(
    problem: TrajectoryProblem, path: JointPath
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the force (K, 3) at path parameters (K,), at the largest speed of each piece."""
    own, speeds = problem.path_force, path.speeds

    def force(s: np.ndarray) -> np.ndarray:
        found = np.repeat(problem.process_force[None], len(s), axis=0)
        if own is None:
            return found
        feed = 0.0 if speeds is None else speeds[path.piece_index(s)]
        return np.asarray(found + own(s, np.where(np.isfinite(feed), feed, 0.0)))

    return force


def _force_history(
    problem: TrajectoryProblem, path: JointPath, law: Trajectory
) -> ForceHistory | None:
    """Return the force of the path over the time of its law."""
    if problem.path_force is None:
        return None
    time = np.linspace(0.0, law.duration, max(2001, int(law.duration / 1e-3)))
    s, rate = law(time)[:, 0], law(time, 1)[:, 0]
    tree, tool = problem.robot.tree, problem.robot.tool
    _, jacobian = tool_jacobians(tree, tool, path(s))
    slope = np.linalg.norm(np.einsum("kij,kj->ki", jacobian, path(s, 1)), axis=1)
    return ForceHistory(time, problem.path_force(s, slope * rate))
