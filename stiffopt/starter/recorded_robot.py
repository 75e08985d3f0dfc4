"""Robot of a recording set: a URDF or robot file as it is, or a URDF with its gaps guessed."""

from __future__ import annotations

import re
import shutil
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from stiffopt.errors import InputFileError
from stiffopt.files import load_toml, read_text
from stiffopt.robot.body_tree import body_tree
from stiffopt.robot.files import load_robot
from stiffopt.robot.joint_tree import JointTree
from stiffopt.robot.robot import Robot
from stiffopt.robot.urdf import load_urdf
from stiffopt.robot.urdf_tree import read_tree
from stiffopt.starter.robot_file import robot_text
from stiffopt.starter.writing import toml_string

ROBOT_FILE = "robot.toml"
_URDF_FILE, _CATALOGUE_FILE = "robot.urdf", "catalogue.toml"
# Names of files in a robot file.
_FILE_ENTRIES = {"urdf": _URDF_FILE, "catalogue": _CATALOGUE_FILE}


@dataclass(frozen=True, kw_only=True)
class RecordedRobot:
    """Robot of a recording set, and its files.

    Parameters
    ----------
    robot : Robot
    file : str
        Name of the file in the set that describes it.
    notes : tuple of str
        What was guessed.
    """

    robot: Robot
    file: str
    notes: tuple[str, ...] = ()


def store_robot(source: Path, folder: Path, tip: str | None = None) -> RecordedRobot:
    """Copy a robot into a folder; beside a URDF with gaps, a robot file with guesses in them.

    Guessed are limits and masses, no drivetrains and no friction: what recordings tell is no guess.

    Parameters
    ----------
    source : Path
        URDF or robot TOML.
    folder : Path
    tip : str, optional
        Link at the end of the arm, of a URDF that holds more than what was recorded.

    Raises
    ------
    InputFileError, RobotError
        No robot that can be read.
    """
    if source.suffix.lower() == ".toml":
        if tip is not None:
            raise InputFileError(source, "", "names its tool itself: leave out --tip.")
        robot = load_robot(source)
        _copy_robot_file(source, folder)
        return RecordedRobot(robot=robot, file=ROBOT_FILE)
    # Of several arms all can have been recorded.
    every = [] if tip else JointTree(read_tree(source)).branch_joints()
    if tip is None and not _has_gaps(source, every):
        robot = load_robot(source, keep=every)
        shutil.copyfile(source, folder / _URDF_FILE)
        return RecordedRobot(robot=robot, file=_URDF_FILE)
    started = robot_text(source, folder, tip, bare=True)
    shutil.copyfile(source, folder / _URDF_FILE)
    (folder / ROBOT_FILE).write_text(
        _replace_entry(started.text, "urdf", _URDF_FILE), encoding="utf-8"
    )
    return RecordedRobot(
        robot=load_robot(folder / ROBOT_FILE), file=ROBOT_FILE, notes=started.notes
    )


def _has_gaps(urdf: Path, keep: Collection[str]) -> bool:
    """Whether a URDF lacks limits or masses of joints that move."""
    arm = load_urdf(urdf, keep=keep, limited=None, followers=True)
    silent = any(not (each["effort"] and each["velocity"]) for each in arm.joints.values())
    weightless = any(not body.mass > 0.0 for body in body_tree(arm.model).bodies)
    return silent or weightless or bool(arm.unlimited)


def _copy_robot_file(source: Path, folder: Path) -> None:
    text, entries = read_text(source), load_toml(source)
    for entry, name in _FILE_ENTRIES.items():
        if entry in entries:
            shutil.copyfile(source.parent / entries[entry], folder / name)
            text = _replace_entry(text, entry, name)
    (folder / ROBOT_FILE).write_text(text, encoding="utf-8")


def _replace_entry(text: str, entry: str, name: str) -> str:
    """Text of a robot file whose entry names another file."""
    return re.sub(rf"(?m)^{entry}\s*=.*$", f"{entry} = {toml_string(name)}", text, count=1)
