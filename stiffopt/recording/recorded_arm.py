"""Arm of a recording set, reduced to the recorded joints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputFileError, nearest
from stiffopt.recording.schema import ArmSection
from stiffopt.robot.files import load_robot, shipped_robots
from stiffopt.robot.frames import frame_names, named_frame
from stiffopt.robot.mjcf import is_mjcf
from stiffopt.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedArm:
    """Arm and metadata common to all kinds of recording sets."""

    path: Path  # TOML file of the set
    name: str
    title: str
    citation: str
    licence: str
    # Nominal: the recorded joints in the robot's own order, which need not be that of the set.
    robot: Robot
    joints: tuple[str, ...]  # (n,) in the order of the set
    locked: tuple[str, ...]  # moving joints that the set does not list; held at zero

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @cached_property
    def order(self) -> np.ndarray:
        """Index of each joint of the set in the robot, (n,)."""
        return joint_order(self.robot, self.joints)

    @property
    def prismatic(self) -> np.ndarray:
        """Return which joints of the set are prismatic, (n,) of bool."""
        return np.asarray(self.robot.prismatic[self.order])


def describe_arm(document: ArmSection, path: Path) -> dict[str, Any]:
    """Return what the file of a set says of its arm and its source."""
    names = ("name", "citation", "licence", "joints")
    title = document.title or document.name
    return {"path": path, "title": title} | {name: getattr(document, name) for name in names}


def joint_order(robot: Robot, joints: Sequence[str]) -> np.ndarray:
    """Index of each of these joints in a robot, (n,)."""
    return np.array([robot.joint_names.index(name) for name in joints])


def load_arm(
    source: str,
    joints: Sequence[str],
    path: Path,
    tool_frame: str | None = None,
    gravity: Sequence[float] | None = None,
) -> tuple[Robot, tuple[str, ...]]:
    """Load the robot of a recording set, and the names of its joints outside the set.

    `source` names a shipped robot, or a URDF or robot TOML beside `path`, the set's own file. A
    shipped robot or a robot TOML has drivetrain, friction and rotor inertia, an MJCF the latter
    two. Friction of a bare URDF is ignored: `<dynamics>` is a setting of simulators. The frame of
    the tool defaults to the robot's last, gravity to 0, 0, -9.81 m/s^2. Raises `InputFileError` or
    `RobotError` for a joint or frame that the robot lacks, a joint named twice, a robot that cannot
    be read.
    """
    shipped = source in shipped_robots()
    robot = load_robot(source if shipped else path_inside_set(path, "robot", source), keep=joints)
    stated = shipped or source.lower().endswith(".toml")
    if not stated and robot.urdf is not None and not is_mjcf(robot.urdf):
        robot = replace(robot, coulomb=np.zeros(robot.n), viscous=np.zeros(robot.n))
    names = robot.joint_names
    for number, name in enumerate(joints):
        if name not in names:
            raise InputFileError(
                path, f"joints[{number + 1}]", f"{source} has no moving joint {name!r}. "
                f"{nearest(name, names)}"
            )  # fmt: skip
        if name in joints[:number]:
            raise InputFileError(path, f"joints[{number + 1}]", f"{name!r} is named twice.")
    locked = tuple(name for name in names if name not in joints)
    robot = robot.with_joints_locked(locked)
    if gravity is not None and 0.9 < math.hypot(*gravity) < 1.1:
        raise InputFileError(
            path,
            "gravity",
            f"{list(gravity)} has the length of 1 m/s^2, which looks like units of g. Write it in "
            "m/s^2, such as [0.0, 0.0, -9.81].",
        )
    robot = robot.with_gravity((0.0, 0.0, -9.81) if gravity is None else gravity)
    frames = frame_names(robot.model)
    if tool_frame is not None and tool_frame not in frames:
        raise InputFileError(
            path, "tool_frame", f"{source} has no frame {tool_frame!r}. "
            f"{nearest(tool_frame, frames)}"
        )  # fmt: skip
    return replace(robot, tool=named_frame(robot.model, tool_frame)), locked


def check_range(
    path: Path, robot: Robot, position: np.ndarray, *, slack: float, first_row: int = 1
) -> None:
    """Raise `InputFileError` for positions (K, n) beyond the ranges of the joints by `slack`."""
    low, high = robot.position_lower, robot.position_upper
    beyond = np.maximum(low - position, position - high)
    if beyond.max() > slack:
        row, j = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        unit = "m" if robot.prismatic[j] else "rad"
        raise InputFileError(
            path, f"row {row + first_row}", f"{robot.joint_names[j]} is at {position[row, j]:.4g} "
            f"{unit}, outside its range from {low[j]:.4g} to {high[j]:.4g}. Check units and order "
            "of the columns, and the robot."
        )  # fmt: skip


def path_inside_set(path: Path, where: str, name: str) -> Path:
    """Path of a file named by a set; raises `InputFileError` outside the set's folder."""
    given = Path(name)
    if given.is_absolute() or ".." in given.parts:
        raise InputFileError(
            path, where, f"{name!r} lies outside of the set. Copy or link it into {path.parent}."
        )
    return path.parent / given
