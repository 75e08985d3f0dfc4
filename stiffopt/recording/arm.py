"""The rigid robot that a recording set names, reduced to the joints that were recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from stiffopt.errors import InputFileError, nearest
from stiffopt.robot.files import load_robot, shipped_robots
from stiffopt.robot.robot import is_prismatic


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """Rigid bodies and limits of the recorded joints.

    Parameters
    ----------
    model : pinocchio.Model
        The recorded joints in the robot's own order; no rotor inertia in it.
    order : array (n,) of int
        Index of each joint of the set in the model's velocity vector.
    prismatic : array (n,) of bool
    position_lower, position_upper, velocity_max, torque_max : array (n,)
        In the set's order; infinite where the robot has no such limit.
    locked : tuple of str
        Moving joints that the set does not list; held at zero.
    """

    model: Any
    order: np.ndarray
    prismatic: np.ndarray
    position_lower: np.ndarray
    position_upper: np.ndarray
    velocity_max: np.ndarray
    torque_max: np.ndarray
    locked: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class SetOfArm:
    """What every set that was recorded on an arm says.

    Parameters
    ----------
    path : Path
        Of its TOML file.
    name, title, citation, licence : str
    arm : Arm
    joints : tuple of str (n,)
    """

    path: Path
    name: str
    title: str
    citation: str
    licence: str
    arm: Arm
    joints: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def model(self) -> Any:
        """pinocchio.Model of the nominal robot: the listed joints in the robot's own order."""
        return self.arm.model

    @property
    def order(self) -> np.ndarray:
        """Index of each joint of the set in the model's velocity vector, (n,)."""
        return self.arm.order


def load_arm(
    source: str,
    joints: Sequence[str],
    path: Path,
    tool_frame: str | None = None,
    gravity: Sequence[float] | None = None,
) -> Arm:
    """Arm of a recording set.

    Parameters
    ----------
    source : str
        Name of a shipped robot, or a URDF or robot TOML beside `path`.
    joints : sequence of str (n,)
        Joints of the set, in the set's order.
    path : path
        The set's own file, for messages and to find `source`.
    tool_frame : str, optional
        Must be a frame of the robot.
    gravity : sequence of float (3,), optional
        [m/s^2]; default 0, 0, -9.81.

    Raises
    ------
    InputFileError, RobotError
        A joint or frame that the robot lacks, a joint named twice, a robot that cannot be read.
    """
    shipped = source in shipped_robots()
    robot = load_robot(source if shipped else inside(path, "robot", source))
    names = list(robot.joint_names)
    for number, name in enumerate(joints):
        if name not in names:
            raise InputFileError(
                path, f"joints[{number + 1}]", f"{source} has no moving joint {name!r}. "
                f"{nearest(name, names)}"
            )  # fmt: skip
        if name in joints[:number]:
            raise InputFileError(path, f"joints[{number + 1}]", f"{name!r} is named twice.")
    rows = np.array([names.index(name) for name in joints])
    locked = tuple(name for name in names if name not in joints)
    model = pin.Model(robot.model)
    if locked:
        model = pin.buildReducedModel(
            model, [model.getJointId(name) for name in locked], pin.neutral(model)
        )
    # The rotors have their own entry in the balance of the motor.
    model.armature = np.zeros(model.nv)
    model.gravity.linear = np.array((0.0, 0.0, -9.81) if gravity is None else gravity)
    if tool_frame is not None and not model.existFrame(tool_frame):
        frames = [frame.name for frame in model.frames if frame.name != "universe"]
        raise InputFileError(
            path, "tool_frame", f"{source} has no frame {tool_frame!r}. "
            f"{nearest(tool_frame, frames)}"
        )  # fmt: skip
    return Arm(
        model=model,
        order=np.array([model.joints[model.getJointId(name)].idx_v for name in joints]),
        prismatic=is_prismatic(robot.model)[rows],
        position_lower=robot.position_lower[rows],
        position_upper=robot.position_upper[rows],
        velocity_max=robot.velocity_max[rows],
        torque_max=robot.torque_max[rows],
        locked=locked,
    )


def inside(path: Path, where: str, name: str) -> Path:
    """Path of a file that a set names, which must lie in the set's own folder."""
    given = Path(name)
    if given.is_absolute() or ".." in given.parts:
        raise InputFileError(
            path, where, f"{name!r} lies outside of the set. Copy or link it into {path.parent}."
        )
    return path.parent / given
