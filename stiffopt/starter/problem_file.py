"""A first problem for a robot: a motion about the middle of its range that it can make."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.errors import NotSimulatedError, RobotError
from stiffopt.robot.robot import Robot
from stiffopt.starter.writing import beside, listed, number, quoted

# Share of each range that the motion covers, and of an endless joint [rad].
_SHARE, _ENDLESS = 0.15, 0.6
# Over the shortest time that the quintic motion needs.
_ROOM = 2.0
_TRIES = 200


def problem_text(robot: Robot, file: str | Path, folder: Path) -> str:
    """Text of a trajectory problem file.

    Parameters
    ----------
    robot : Robot
    file : str or Path
        Shipped name, or path of the robot's file.
    folder : Path
        That the problem is to lie in.

    Raises
    ------
    RobotError
        No pose was found that the drives can hold.
    """
    start, end = _poses(robot)
    swing = _swing(robot, start) if robot.tool_yields(np.array([start, end])) else None
    named = beside(file, folder) if isinstance(file, Path) else file
    objective = (
        ('"torque_squared"',) if swing is None else ('"shaped_deviation"', 'measure = "peak"')
    )
    why = (
        "a rigid tool: least heat. With joints that yield, minimise shaped_deviation"
        if swing is None
        else "least deviation of the tool, links that swing included; rest after arrival"
    )
    lines = [
        f"# First problem for {robot.name}, written by `stiffopt init problem`: poses about the",
        "# middle of the joints' ranges. Collisions of your cell are not known to it.",
        "schema = 1",
        'kind = "trajectory"',
        f"title = {quoted(f'First motion of {robot.name}')}",
        f"robot = {quoted(named)}",
        "",
        "# [payload]",
        "# mass = 1.0                  # [kg], at the flange",
        '# com = ["0 mm", "0 mm", "50 mm"]',
        "# inertia = [1e-3, 1e-3, 1e-3]",
        "",
        "[motion]",
        f"start = {{ joints = {_pose(robot, start)} }}",
        f"end = {{ joints = {_pose(robot, end)} }}",
        f'duration = "{_duration(robot, start, end, swing or 0.0):.2g} s"',
        "",
        "[[minimise]]",
        f"objective = {objective[0]}     # {why}",
        *objective[1:],
        "",
        "[method]",
        "intervals = 40",
    ]
    return "\n".join(lines) + "\n"


def _poses(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Start and end (n,) that the drives hold, about the middle of the ranges."""
    low, high = robot.position_lower, robot.position_upper
    finite = np.isfinite(high - low)
    low, high = np.where(finite, low, 0.0), np.where(finite, high, 0.0)
    middle = 0.5 * (low + high)
    half = np.where(finite, 0.5 * _SHARE * (high - low), 0.5 * _ENDLESS)
    half = np.minimum(half, np.where(robot.prismatic, np.inf, 0.5 * _ENDLESS))
    random = np.random.default_rng(1)
    bodies = robot.rigid_bodies()
    least, least_joint, needed = np.inf, 0, 0.0
    for trial in range(_TRIES):
        if trial:
            span = np.where(finite, 0.3 * (high - low), 1.0)
            centre = middle + random.uniform(-1.0, 1.0, robot.n) * span
        else:
            centre = middle
        poses = np.round(centre - half, 3), np.round(centre + half, 3)
        weight = np.max([np.abs(bodies.gravity_torque(pose)) for pose in poses], axis=0)
        share = weight / robot.torque_max
        if share.max() <= 0.8:
            return poses
        if share.max() < least:
            least, least_joint = float(share.max()), int(np.argmax(share))
            needed = float(weight[least_joint])
    raise RobotError(
        f"{robot.name}: in none of {_TRIES} poses do its drives hold its weight:"
        f" {robot.joint_names[least_joint]} has {robot.torque_max[least_joint]:g} N m and needs"
        f" {needed:.3g} at least. Correct torque_max of the robot file, or its masses."
    )


def _pose(robot: Robot, pose: np.ndarray) -> str:
    return listed(
        number(value) if slides else quoted(f"{np.degrees(value):.1f} deg")
        for value, slides in zip(pose, robot.prismatic, strict=True)
    )


def _swing(robot: Robot, pose: np.ndarray) -> float | None:
    """Period of the arm's lowest mode [s]; None for an arm that does not swing."""
    try:
        found = modes(ElasticArm(robot, pose), pose)
    except NotSimulatedError:
        return None
    return 1.0 / found[0].frequency if found else None


def _duration(robot: Robot, start: np.ndarray, end: np.ndarray, swing: float) -> float:
    """Of a quintic motion within velocity, acceleration and jerk, with room and two swings [s]."""
    way = np.abs(end - start)
    times = (
        (1.875 * way / robot.velocity_max).max(),
        np.sqrt(5.78 * way / robot.acceleration_max).max(),
        np.cbrt(60.0 * way / robot.jerk_max).max(),
        0.2,
    )
    return float(np.ceil(10.0 * (_ROOM * max(times) + 2.0 * swing)) / 10.0)
