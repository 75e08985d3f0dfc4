"""Inverse kinematics of a problem's poses, with the checks that need no solver.

Input errors are faults that no duration can remedy: a start outside the joint range, a pose out of
reach, a pose that the drives cannot hold at rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.dynamics.inverse_kinematics import solve_pose
from stiffopt.errors import ProblemError
from stiffopt.problem.branches import within_limits
from stiffopt.problem.input_checks import check_plausible
from stiffopt.problem.limit import Limits
from stiffopt.problem.rest_poses import gravity_torque
from stiffopt.problem.trajectory import ResolvedMotion, Target, TrajectoryProblem
from stiffopt.robot.frames import interpolate_rotation, rotation_from_rpy, rpy_from_rotation
from stiffopt.robot.robot import Robot
from stiffopt.units import joint_unit


def resolve(problem: TrajectoryProblem) -> ResolvedMotion:
    """Resolve all poses and check those that the motion must take.

    Raises `ProblemError`: a pose is out of reach or out of range, or cannot be held at rest.
    """
    check_plausible(problem)
    if problem.path is not None:
        return _resolve_path(problem)
    start = _resolve_target(problem, problem.start, "motion.start", None)
    vias = []
    near = start
    end = _resolve_target(problem, problem.end, "motion.end", start)
    for number, via in enumerate(problem.vias, start=1):
        where = f"motion.via[{number}]"
        near = _resolve_target(
            problem, _interpolate_orientation(problem, via, start, end), where, near
        )
        vias.append(near)
    motion = ResolvedMotion(
        start, end, tuple(vias), problem.start.fixes_pose, problem.end.fixes_pose
    )
    for where, target, angles in (
        ("motion.start", problem.start, start),
        ("motion.end", problem.end, end),
    ):
        if target.fixes_pose:
            check_range(problem.robot, problem.active_limits, where, angles)
            _check_rest(problem, where, angles)
    _check_boundary_velocity(problem)
    _check_stopping_distance(problem, motion)
    for number, (via, angles) in enumerate(zip(problem.vias, vias, strict=True), start=1):
        if via.joints is not None:
            check_range(problem.robot, problem.active_limits, f"motion.via[{number}]", angles)
    return motion


def _resolve_target(
    problem: TrajectoryProblem, target: Target, where: str, near: np.ndarray | None
) -> np.ndarray:
    if target.joints is not None:
        if target.joints.shape != (problem.joints,) or not np.all(np.isfinite(target.joints)):
            raise ProblemError(
                f"{where}.joints needs {problem.joints} finite angles, got "
                f"{np.array2string(target.joints, precision=4)}."
            )
        return target.joints
    guess = target.near if target.near is not None else near
    rotation = None if target.rpy is None else rotation_from_rpy(target.rpy)
    try:
        robot = within_limits(problem.robot, problem.active_limits)
        return np.asarray(solve_pose(robot, target.position, rotation, guess))
    except ProblemError as error:
        raise ProblemError(f"{where}: {error}") from error


def _interpolate_orientation(
    problem: TrajectoryProblem, via: Target, start: np.ndarray, end: np.ndarray
) -> Target:
    """Give a via position an orientation between those of start and end, if it can be reached.

    The optimiser leaves the orientation at a via free; initial guess and baselines need one.
    """
    if via.position is None or via.rpy is not None:
        return via
    bodies, tool = problem.robot.rigid_bodies(), problem.robot.tool
    (first, first_turn), (last, last_turn) = bodies.pose(tool, start), bodies.pose(tool, end)
    before = float(np.linalg.norm(via.position - first))
    after = float(np.linalg.norm(last - via.position))
    rotation = interpolate_rotation(first_turn, last_turn, before / max(before + after, 1e-12))
    oriented = replace(via, rpy=rpy_from_rotation(rotation))
    try:
        robot = within_limits(problem.robot, problem.active_limits)
        solve_pose(robot, oriented.position, rotation, start)
    except ProblemError:
        return via
    return oriented


def _resolve_path(problem: TrajectoryProblem) -> ResolvedMotion:
    path = problem.path
    assert path is not None
    points = path.points
    for number, angles in enumerate(points, start=1):
        check_range(problem.robot, problem.active_limits, f"motion.path[{number}]", angles)
    for number in (1, len(points)):
        _check_rest(problem, f"motion.path[{number}]", points[number - 1])
    return ResolvedMotion(points[0], points[-1], (), True, True)


def check_range(
    robot: Robot, limits: Limits, where: str, angles: np.ndarray, remedy: str = ""
) -> None:
    """Raise `ProblemError` where a joint of a pose (n,) [rad] is outside its position limits."""
    for j, angle in enumerate(angles):
        low, high = limits.position_lower[j], limits.position_upper[j]
        if not low - 1e-9 <= angle <= high + 1e-9:
            key = "position_lower" if angle < low else "position_upper"
            at, lower, upper = (
                _format_position(value, bool(robot.prismatic[j])) for value in (angle, low, high)
            )
            raise ProblemError(
                f"{where}: joint {j + 1} at {at} is outside its range {lower} to {upper}. Choose a "
                f"pose within the range{remedy or f', or change limits.{key}'}."
            )


def _check_boundary_velocity(problem: TrajectoryProblem) -> None:
    if problem.boundary_velocity is None:
        return
    limit = problem.active_limits.velocity
    for side, velocity in zip(("start", "end"), problem.boundary_velocity, strict=True):
        where = f"motion.boundary_velocity.{side}"
        if np.shape(velocity) != (problem.joints,) or not np.all(np.isfinite(velocity)):
            raise ProblemError(f"{where} needs {problem.joints} finite numbers, got {velocity}.")
        for j in np.flatnonzero(np.abs(velocity) > limit):
            raise ProblemError(
                f"{where}: joint {j + 1} at {velocity[j]:.4g} exceeds its velocity limit "
                f"{limit[j]:.4g}, so no duration can connect it. Lower it, or raise "
                "limits.velocity."
            )


def _check_stopping_distance(problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
    """Raise where a joint at a moving end cannot brake before its position limit.

    The end of a motion is checked in reversed time. A joint that keeps its direction from start to
    end need not brake.
    """
    if problem.boundary_velocity is None:
        return
    limits = problem.active_limits
    first, last = (np.asarray(v, dtype=float) for v in problem.boundary_velocity)
    ends = (
        ("start", motion.start, motion.start_fixed, first, last),
        ("end", motion.end, motion.end_fixed, -last, -first),
    )
    for side, position, fixed, velocity, other in ends:
        room = np.where(
            velocity > 0.0, limits.position_upper - position, position - limits.position_lower
        )
        needed = stopping_distance(
            np.abs(velocity),
            limits.acceleration,
            limits.jerk if problem.boundary_acceleration == "zero" else np.inf,
        )
        for j in np.flatnonzero((needed > room) & (velocity * other <= 0.0)) if fixed else ():
            prismatic = bool(problem.robot.prismatic[j])
            ahead, braking = (_format_position(d, prismatic) for d in (room[j], needed[j]))
            raise ProblemError(
                f"motion.boundary_velocity.{side}: joint {j + 1} has {ahead} to its position limit "
                f"and needs {braking} to brake from {abs(velocity[j]):.4g} "
                f"{joint_unit('rad/s', prismatic)} within its acceleration and jerk limits, so no "
                "duration can connect it. Lower the velocity, or choose a pose further from the "
                "limit."
            )


def stopping_distance(
    speed: np.ndarray, acceleration: np.ndarray, jerk: np.ndarray | float
) -> np.ndarray:
    """Return the least distance (n,) from `speed` to standstill, from zero acceleration.

    Constant jerk until the acceleration limit, then constant acceleration; infinite limits give 0.
    `speed`, `acceleration` and `jerk` (n,): not negative, the limits positive [rad/s], [rad/s^2],
    [rad/s^3] or the same in m.
    """
    # A jump of the acceleration where the jerk has no limit: no time and no distance.
    finite = np.where(np.isfinite(jerk), jerk, 0.0)
    ramp = np.zeros(np.broadcast_shapes(np.shape(speed), np.shape(finite)))
    np.sqrt(2.0 * speed / np.where(finite > 0.0, finite, 1.0), where=finite > 0.0, out=ramp)
    limited = (finite > 0.0) & (finite * ramp > acceleration)
    np.divide(acceleration, finite, where=limited, out=ramp)
    drop = finite * ramp
    left = np.maximum(speed - drop * ramp / 2.0, 0.0)
    return np.asarray(speed * ramp - drop * ramp**2 / 6.0 + left**2 / (2.0 * acceleration))


def _check_rest(problem: TrajectoryProblem, where: str, angles: np.ndarray) -> None:
    """Raise `ProblemError` where holding a pose at rest exceeds a torque limit."""
    if problem.boundary_acceleration != "zero" or not problem.rests_at_both_ends:
        return
    torque, limit = gravity_torque(problem, angles), problem.active_limits.torque
    for j in np.flatnonzero(np.abs(torque) > limit):
        unit = joint_unit("N m", bool(problem.robot.prismatic[j]))
        raise ProblemError(
            f"{where}: holding this pose takes {abs(torque[j]):.3g} {unit} at joint {j + 1}, above "
            f"its torque limit {limit[j]:.3g} {unit}, so no duration can connect it. Choose "
            "another pose, a lighter payload, or raise limits.torque."
        )


def _format_position(position: float, prismatic: bool) -> str:
    if prismatic:
        return f"{position:.4g} m"
    return f"{position:.4g} rad ({np.degrees(position):.4g} deg)"
