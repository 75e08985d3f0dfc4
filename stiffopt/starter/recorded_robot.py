"""Robot of a new recording set: copies of its files, and guesses for what they lack."""

from __future__ import annotations

import re
import shutil
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import load_toml, read_text
from stiffopt.robot.files import load_robot, robot_path
from stiffopt.robot.joint_tree import JointTree
from stiffopt.robot.mjcf import is_mjcf, mjcf_files, names_in_common_folder, read_mjcf
from stiffopt.robot.robot import Robot
from stiffopt.robot.urdf import load_urdf
from stiffopt.robot.urdf_xml import read_urdf_tree
from stiffopt.starter.robot_file import robot_text
from stiffopt.starter.writing import toml_list, toml_number, toml_string

# Joint values of an MJCF.
_JOINT_VALUES = ("coulomb", "viscous", "rotor_inertia")

ROBOT_FILE = "robot.toml"
_URDF_FILE, _CATALOGUE_FILE = "robot.urdf", "catalogue.toml"


@dataclass(frozen=True, kw_only=True)
class RecordedRobot:
    """Robot of a recording set and its file."""

    robot: Robot
    file: str  # name of its file in the set
    notes: tuple[str, ...] = ()  # guesses, a sentence each

    def tool_lines(self) -> tuple[str, ...]:
        """Return the line of recordings.toml on the hand; none where several links end the arm."""
        tool, model = self.robot.tool, self.robot.model
        if tool.joint != self.robot.n or not model.existFrame(tool.link):
            return ()
        return (f"tool_frame = {toml_string(tool.link)}  # where a force at the hand acts",)

    def entries(self, *, torque: bool) -> tuple[str, ...]:
        """Return lines of recordings.toml on an MJCF, for recordings with or without torques."""
        if self.robot.urdf is None or not is_mjcf(self.robot.urdf):
            return ()
        # Relative tolerance of joint values. Beside torques a change by a tenth is to be reported,
        # and a fit moves a value by some tolerances before it names an effect. Without torques
        # gains, friction and inertia are told from the motion together: on a real leg the error of
        # held-out motions was 4.4 mrad with 0.05, 2.5 mrad with 0.3 and 2.9 mrad without a
        # tolerance.
        return _mjcf_entries(self.robot, 0.05 if torque else 0.3)


def store_robot(source: Path, folder: Path, tip: str | None = None) -> RecordedRobot:
    """Copy a robot into a folder; add a robot file with guesses for an incomplete URDF or MJCF.

    Limits and masses are guessed, drivetrains and friction are not: recordings determine them.
    """
    source = robot_path(source)
    if source.suffix.lower() == ".toml":
        if tip is not None:
            raise InputFileError(source, "", "names its tool itself: leave out --tip.")
        robot = load_robot(source)
        _copy_robot_file(source, folder)
        return RecordedRobot(robot=robot, file=ROBOT_FILE)
    # All arms of a URDF may have been recorded.
    every = [] if tip else JointTree(read_urdf_tree(source)).ambiguous_joints()
    if tip is None and not _has_gaps(source, every):
        robot = load_robot(source, keep=every)
        name = _copy_model(source, folder)
        return RecordedRobot(robot=robot, file=name)
    started = robot_text(source, folder, tip, keep=every, bare=True)
    text = _replace_entry(started.text, "urdf", _copy_model(source, folder))
    (folder / ROBOT_FILE).write_text(text, encoding="utf-8")
    notes = (*started.notes, *(read_mjcf(source).notes if is_mjcf(source) else ()))
    robot = load_robot(folder / ROBOT_FILE)
    return RecordedRobot(robot=robot, file=ROBOT_FILE, notes=notes)


def _mjcf_entries(robot: Robot, tolerance: float) -> tuple[str, ...]:
    """Return lines on springs of an MJCF's joints, tolerance of its joint values, servo gains."""
    assert robot.urdf is not None
    lines: list[str] = []
    model = read_mjcf(robot.urdf)
    for name, joint in model.joints.items():
        if name in robot.joint_names and joint.stiffness != 0.0:
            lines += [
                "",
                "[[nominal.counterbalance]]  # spring of the MJCF",
                'type = "spring"',
                f"joint = {toml_string(name)}",
                f"stiffness = {toml_number(joint.stiffness)}",
                f"offset = {toml_number(joint.spring_reference)}",
            ]
    stated = [key for key in _JOINT_VALUES if np.any(getattr(robot, key))]
    if stated:
        lines += ["", "[tolerance]  # relative, of the MJCF's values: larger changes are findings"]
        lines += [f"{key} = {tolerance}" for key in stated]
    servos = {each.joint: each for each in model.actuators if each.position_gain > 0.0}
    if set(servos) >= set(robot.joint_names):
        own = [servos[name] for name in robot.joint_names]
        lines += [
            "",
            "# [actuator]  # servos of the MJCF: uncomment where the real ones have these gains",
            '# kind = "position_servo"',
            f"# kp = {toml_list(toml_number(each.position_gain) for each in own)}",
            f"# kd = {toml_list(toml_number(each.velocity_gain) for each in own)}",
        ]
    return tuple(lines)


def _copy_model(source: Path, folder: Path) -> str:
    """Copy a URDF or the files of an MJCF into a folder; return the path there.

    The files of an MJCF name each other: they keep their names and places to each other.
    """
    if not is_mjcf(source):
        shutil.copyfile(source, folder / _URDF_FILE)
        return _URDF_FILE
    files = names_in_common_folder(mjcf_files(source))
    for name, file in files.items():
        copy = folder / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    return next(iter(files))


def _has_gaps(urdf: Path, keep: Collection[str]) -> bool:
    """Return True if a URDF or MJCF lacks limits or masses of moving joints."""
    arm = load_urdf(urdf, keep=keep, limited=None, hold_unplanned=True)
    silent = any(not (each["effort"] and each["velocity"]) for each in arm.joints.values())
    return silent or bool(arm.joints_without_masses) or bool(arm.unlimited)


def _copy_robot_file(source: Path, folder: Path) -> None:
    text, entries = read_text(source), load_toml(source)
    if "urdf" in entries:
        text = _replace_entry(text, "urdf", _copy_model(source.parent / entries["urdf"], folder))
    if "catalogue" in entries:
        shutil.copyfile(source.parent / entries["catalogue"], folder / _CATALOGUE_FILE)
        text = _replace_entry(text, "catalogue", _CATALOGUE_FILE)
    (folder / ROBOT_FILE).write_text(text, encoding="utf-8")


def _replace_entry(text: str, entry: str, name: str) -> str:
    """Replace the file name of an entry in the text of a robot file."""
    return re.sub(rf"(?m)^{entry}\s*=.*$", f"{entry} = {toml_string(name)}", text, count=1)
