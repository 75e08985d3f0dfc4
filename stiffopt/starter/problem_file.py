"""A first problem for a robot: a motion about the middle of its range that it can make."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stiffopt.robot.robot import Robot
from stiffopt.starter.first_motion import first_motion
from stiffopt.starter.writing import relative_path, toml_list, toml_number, toml_string


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
        No pose was found that the drives can hold and where links do not meet.
    """
    motion = first_motion(robot)
    named = relative_path(file, folder) if isinstance(file, Path) else file
    if not motion.yields:
        objective = ['"torque_squared"']
        why = "a rigid tool: least heat. With joints that yield, minimise shaped_deviation"
    elif motion.bare:
        objective = ['"torque_squared"']
        why = (
            f"least heat: {motion.bare}, the strongest, is rigid here. Give its elements, then"
            " minimise shaped_deviation"
        )
    else:
        objective = ['"shaped_deviation"', 'measure = "peak"']
        why = "least deviation of the tool, links that swing included; rest after arrival"
    cell = (
        "links are kept from each other; state what stands around"
        if motion.checked
        else "links are not kept from each other: the URDF has no shapes of any that could meet"
    )
    lines = [
        f"# First problem for {robot.name}, written by `stiffopt init problem`: poses about the",
        "# middle of the joints' ranges. Collisions of your cell are not known to it.",
        "schema = 1",
        'kind = "trajectory"',
        f"title = {toml_string(f'First motion of {robot.name}')}",
        f"robot = {toml_string(named)}",
        "",
        "# [payload]",
        "# mass = 1.0                  # [kg], at the flange",
        '# com = ["0 mm", "0 mm", "50 mm"]',
        "# inertia = [1e-3, 1e-3, 1e-3]",
        "",
        f"# [cell]                       # {cell}",
        '# floor = "0 mm"               # height, base frame',
        '# clearance = "20 mm"',
        "",
        "[motion]",
        f"start = {{ joints = {_format_pose(robot, motion.start)} }}",
        f"end = {{ joints = {_format_pose(robot, motion.end)} }}",
        f'duration = "{motion.duration:.3g} s"',
        "",
        "[[minimise]]",
        f"objective = {objective[0]}     # {why}",
        *objective[1:],
        "",
        "[method]",
        "intervals = 40",
    ]
    return "\n".join(lines) + "\n"


def _format_pose(robot: Robot, pose: np.ndarray) -> str:
    return toml_list(
        toml_number(value) if slides else toml_string(f"{np.degrees(value):.1f} deg")
        for value, slides in zip(pose, robot.prismatic, strict=True)
    )
