"""A first problem for a robot: a motion about the middle of its range that it can make."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stiffopt.errors import RobotError
from stiffopt.robot.robot import Robot
from stiffopt.starter.writing import beside, listed, number, quoted

# Share of each range that the motion covers, and of an endless joint [rad].
_SHARE, _ENDLESS = 0.15, 0.6
# Over the shortest time that the quintic motion needs.
_ROOM = 1.3
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
    elastic = any(chain is not None and chain.stages for chain in robot.chains)
    named = beside(file, folder) if isinstance(file, Path) else file
    objective = ('"dynamic_deflection"', 'measure = "peak"') if elastic else ('"torque_squared"',)
    why = (
        "least deviation of the tool from the static sag, peak over the motion"
        if elastic
        else "a rigid robot: least heat. With drivetrains, minimise dynamic_deflection"
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
        f'duration = "{_duration(robot, start, end):.2g} s"',
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
    middle = np.where(finite, 0.5 * (low + high), 0.0)
    half = np.where(finite, 0.5 * _SHARE * (high - low), 0.5 * _ENDLESS)
    half = np.minimum(half, np.where(robot.prismatic, np.inf, 0.5 * _ENDLESS))
    random = np.random.default_rng(1)
    bodies = robot.rigid_bodies()
    for trial in range(_TRIES):
        if trial:
            span = np.where(finite, 0.3 * (high - low), 1.0)
            centre = middle + random.uniform(-1.0, 1.0, robot.n) * span
        else:
            centre = middle
        poses = np.round(centre - half, 3), np.round(centre + half, 3)
        held = [np.abs(bodies.gravity_torque(pose)) <= 0.8 * robot.torque_max for pose in poses]
        if all(each.all() for each in held):
            return poses
    raise RobotError(
        f"{robot.name}: in none of {_TRIES} poses do its drives hold its weight. Look at masses and"
        " torque limits."
    )


def _pose(robot: Robot, pose: np.ndarray) -> str:
    return listed(
        number(value) if slides else quoted(f"{np.degrees(value):.1f} deg")
        for value, slides in zip(pose, robot.prismatic, strict=True)
    )


def _duration(robot: Robot, start: np.ndarray, end: np.ndarray) -> float:
    """Of a quintic motion within velocity, acceleration and jerk, with room [s]."""
    way = np.abs(end - start)
    times = (
        (1.875 * way / robot.velocity_max).max(),
        np.sqrt(5.78 * way / robot.acceleration_max).max(),
        np.cbrt(60.0 * way / robot.jerk_max).max(),
        0.2,
    )
    return float(np.ceil(10.0 * _ROOM * max(times)) / 10.0)
