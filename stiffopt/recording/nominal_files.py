"""A set's robot as its own file and the set describe it; drives and noise of the set file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.connection.connection import Connection
from stiffopt.connection.constant import Constant
from stiffopt.connection.reducer import Reducer
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.errors import InputFileError, nearest
from stiffopt.recording.nominal import Counterbalance, Noise, Nominal
from stiffopt.recording.schema import (
    NoiseSection,
    NominalSection,
    ReducerCurvesSection,
    SpringSection,
    TableSection,
)
from stiffopt.robot.elements import located
from stiffopt.robot.files import load_robot, shipped_robots
from stiffopt.robot.frames import frame_names, named_frame
from stiffopt.robot.robot import Robot

# Of the robot, of the drives: lists with a number a joint.
_ROBOT_LISTS = ("rotor_inertia", "coulomb", "viscous", "torque_max")
_DRIVE_LISTS = ("gear_ratio", "torque_rated", "joint_damping")


def per_joint(
    value: float | Sequence[float] | None, n: int, path: Path, where: str
) -> np.ndarray | None:
    """Array (n,) of a list, or of one number that holds for all joints."""
    if value is None:
        return None
    numbers = np.array([value] * n if isinstance(value, float) else value, dtype=float)
    if numbers.shape != (n,):
        raise InputFileError(
            path, where, f"needs one number a joint ({n}), got {numbers.size}. Complete the list."
        )
    if np.isnan(numbers).any():
        raise InputFileError(path, where, "nan is no number to compute with. Leave the key out.")
    return numbers


def as_nominal(section: NominalSection, joints: Sequence[str], path: Path) -> Nominal:
    """What the section says beside the robot, with one entry a joint."""
    n = len(joints)
    lists = {key: _finite(section, key, n, path) for key in _DRIVE_LISTS}
    ratio = lists["gear_ratio"]
    if ratio is not None and not ratio.all():
        raise InputFileError(path, "nominal.gear_ratio", "a ratio of 0 turns nothing.")
    if section.connections is not None and len(section.connections) != n:
        raise InputFileError(
            path,
            "nominal.connections",
            f"needs one text a joint ({n}), got {len(section.connections)}.",
        )
    balance = section.counterbalance
    return Nominal(
        friction_temperature=section.friction_temperature,
        pole_pairs=section.pole_pairs,
        connections=section.connections,
        counterbalance=tuple(
            _counterbalance(one, joints, path)
            for one in (balance if isinstance(balance, tuple) else (balance,))
        ),
        **lists,
    )


def check_nominal(section: NominalSection, joints: Sequence[str], path: Path) -> None:
    """Raise `InputFileError` where a list of the section is of no use for these joints."""
    as_nominal(section, joints, path)
    for key in _ROBOT_LISTS:
        _finite(section, key, len(joints), path)


def as_nominal_robot(
    described: Robot, order: np.ndarray, section: NominalSection, path: Path
) -> Robot:
    """The robot as its file describes it, with all that the section states in its place.

    Parameters
    ----------
    described : Robot
        With the joints of the set, in its own order.
    order : array (n,) of int
        Index of each joint of the set among those of the robot.
    section : NominalSection
    path : Path
        Of the set's file, for messages.
    """
    of_set = np.argsort(order)
    stated: dict[str, Any] = {}
    for key in _ROBOT_LISTS:
        numbers = _finite(section, key, described.n, path)
        if numbers is not None:
            stated[key] = numbers[of_set]
    robot = replace(described, **stated)
    chains = as_chains(section, robot.torque_max[order], path)
    if chains is None:
        return robot
    return replace(robot, chains=tuple(chains[j] for j in of_set))


def unstated(section: NominalSection, described: Robot) -> tuple[str, ...]:
    """Which of coulomb, viscous and rotor_inertia neither a set nor its robot's file gives."""
    return tuple(
        key
        for key in ("coulomb", "viscous", "rotor_inertia")
        if getattr(section, key) is None and not np.any(getattr(described, key))
    )


def as_chains(
    section: NominalSection, torque_max: np.ndarray, path: Path
) -> tuple[Chain | None, ...] | None:
    """Drivetrain of each joint: its reducer, and its contacts as one spring; None is rigid.

    Parameters
    ----------
    section : NominalSection
    torque_max : array (n,)
        [N m]
    path : Path

    Returns
    -------
    tuple of Chain or None (n,), or None
        None where the section says nothing of stiffness.
    """
    n = len(torque_max)
    contacts = per_joint(section.contact_stiffness, n, path, "nominal.contact_stiffness")
    curves = None if section.reducer is None else _curves(section.reducer, n, path)
    if contacts is None and curves is None:
        return None
    chains: list[Chain | None] = []
    for j, most in enumerate(torque_max):
        curve = None if curves is None else curves[:, j]
        with located(path, f"nominal.reducer, joint {j + 1}"):
            chains.append(joint_chain(curve, np.inf if contacts is None else contacts[j], most))
    return tuple(chains)


def joint_chain(
    curve: Sequence[float] | np.ndarray | None, contacts: float, torque_max: float
) -> Chain | None:
    """Drivetrain of a reducer K1, K2, K3, T1, T2 and a contact stiffness [N m/rad]; None is rigid.

    A reducer without a finite slope everywhere, and infinite contacts, are rigid.
    """
    elements: list[Connection] = []
    if curve is not None and np.isfinite(curve[:3]).all():
        k1, k2, k3, t1, t2 = (float(value) for value in curve)
        reducer = Reducer(
            name="reducer",
            torque_max=float(torque_max),
            K1=k1,
            K2=k2,
            K3=k3,
            T1=t1,
            # The element has two corners; equal ones stand for a catalogue with two slopes.
            T2=max(t2, t1 * (1.0 + 1e-9)),
        )
        elements.append(reducer)
    if np.isfinite(contacts):
        most, stiffness = float(torque_max), float(contacts)
        elements.append(Constant(name="contacts", torque_max=most, stiffness=stiffness))
    return Chain(tuple(Stage(element) for element in elements)) if elements else None


def as_noise(section: NoiseSection, n: int, path: Path) -> Noise:
    """Noise with one entry a joint."""
    return Noise(
        **{
            key: per_joint(value, n, path, f"noise.{key}")
            for key, value in section.model_dump().items()
        }
    )


def _finite(section: NominalSection, key: str, n: int, path: Path) -> np.ndarray | None:
    numbers = per_joint(getattr(section, key), n, path, f"nominal.{key}")
    if numbers is not None and not np.isfinite(numbers).all():
        raise InputFileError(path, f"nominal.{key}", f"got {list(numbers)}, not finite.")
    return numbers


def _curves(section: ReducerCurvesSection, n: int, path: Path) -> np.ndarray:
    """K1, K2, K3, T1, T2 of all joints (5, n)."""
    rows = []
    for key in ("K1", "K2", "K3", "T1", "T2"):
        numbers = per_joint(getattr(section, key), n, path, f"nominal.reducer.{key}")
        assert numbers is not None
        rows.append(numbers)
    if not (rows[3] <= rows[4]).all():
        raise InputFileError(path, "nominal.reducer.T2", "must not be below T1. Swap the two.")
    return np.array(rows)


def _counterbalance(
    section: SpringSection | TableSection, joints: Sequence[str], path: Path
) -> Counterbalance:
    where = "nominal.counterbalance"
    joint = section.joint
    if isinstance(joint, str):
        if joint not in joints:
            raise InputFileError(
                path, f"{where}.joint", f"no joint {joint!r}. {nearest(joint, joints)}"
            )
        joint = list(joints).index(joint) + 1
    if not 1 <= joint <= len(joints):
        raise InputFileError(
            path, f"{where}.joint", f"got {joint}, allowed are 1 to {len(joints)} or a name."
        )
    if isinstance(section, SpringSection):
        return Counterbalance(joint=joint - 1, stiffness=section.stiffness, offset=section.offset)
    angle, torque = np.array(section.angle), np.array(section.torque)
    if angle.shape != torque.shape or len(angle) < 2 or not (np.diff(angle) > 0.0).all():
        raise InputFileError(
            path, where, "angle must increase and have as many entries (two or more) as torque."
        )
    return Counterbalance(joint=joint - 1, angle=angle, torque=torque)


def load_arm(
    source: str,
    joints: Sequence[str],
    path: Path,
    tool_frame: str | None = None,
    gravity: Sequence[float] | None = None,
) -> tuple[Robot, tuple[str, ...]]:
    """Robot of a recording set, and its joints that the set leaves out.

    Parameters
    ----------
    source : str
        Name of a shipped robot, or a URDF or robot TOML beside `path`.
    joints : sequence of str (n,)
        Joints of the set, in the set's order.
    path : path
        The set's own file, for messages and to find `source`.
    tool_frame : str, optional
        Must be a frame of the robot; default the last one.
    gravity : sequence of float (3,), optional
        [m/s^2]; default 0, 0, -9.81.

    Raises
    ------
    InputFileError, RobotError
        A joint or frame that the robot lacks, a joint named twice, a robot that cannot be read.

    Notes
    -----
    A robot of the package or of a robot TOML brings its drivetrain, friction and rotor inertia. The
    friction that a bare URDF may name is left out: `<dynamics>` is a setting of simulators.
    """
    shipped = source in shipped_robots()
    robot = load_robot(source if shipped else inside(path, "robot", source), keep=joints)
    if not (shipped or source.lower().endswith(".toml")):
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


def inside(path: Path, where: str, name: str) -> Path:
    """Path of a file that a set names, which must lie in the set's own folder."""
    given = Path(name)
    if given.is_absolute() or ".." in given.parts:
        raise InputFileError(
            path, where, f"{name!r} lies outside of the set. Copy or link it into {path.parent}."
        )
    return path.parent / given
