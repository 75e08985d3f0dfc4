"""What every format of an exported robot must answer, and the registry that holds them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.discovery.extended.changes import ValueChange, torque_gains, value_changes
from stiffopt.discovery.extended.planner_model import planner_model
from stiffopt.discovery.extended.planner_solve import read_model
from stiffopt.discovery.store import MODEL_FILE
from stiffopt.errors import InputFileError
from stiffopt.folders import check_result
from stiffopt.problem.registry import Registry
from stiffopt.recording.recording_set import load_recordings
from stiffopt.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class DiagnosedRobot:
    """A recorded arm with what was found.

    Parameters
    ----------
    name : str
        Of the recording set.
    nominal, robot : Robot
        Before and after.
    gain : array (n,)
        Torque given for one that the drive reports, in the order of the robot's joints.
    changes : tuple of ValueChange
    left_out : tuple of str
        Findings that such a model has no place for.
    """

    name: str
    nominal: Robot
    robot: Robot
    gain: np.ndarray
    changes: tuple[ValueChange, ...]
    left_out: tuple[str, ...]


def read_diagnosed_robot(
    diagnosis: Path, recordings: Path, effects: Path | None = None
) -> DiagnosedRobot:
    """Read extended.toml of a diagnosis and the robot of its recording set.

    Parameters
    ----------
    diagnosis : Path
        Folder of `stiffopt diagnose`.
    recordings : Path
        The recording set.
    effects : Path, optional
        File of the effects that are not of the catalogue.

    Raises
    ------
    InputFileError
        A file is missing, or the set is of another robot.
    """
    check_result(diagnosis, MODEL_FILE)
    model = read_model(diagnosis / MODEL_FILE, effects)
    loaded = load_recordings(recordings)
    if loaded.joints != model.joints:
        raise InputFileError(
            loaded.path,
            "joints",
            f"this diagnosis is of {', '.join(model.joints)}, the set of "
            f"{', '.join(loaded.joints)}. Give the set that was diagnosed.",
        )
    planner = planner_model(loaded.robot, model)
    gain = np.ones(loaded.robot.n)
    gain[loaded.order] = torque_gains(model)
    left_out = tuple(each for each in planner.left_out if not each.startswith("torque_gain"))
    return DiagnosedRobot(
        name=model.name,
        nominal=loaded.robot,
        robot=planner.robot,
        gain=gain,
        changes=tuple(value_changes(loaded.robot, planner.robot)),
        left_out=left_out,
    )


class ModelFormat(ABC):
    """A way to hand a robot to others.

    Attributes
    ----------
    name : str
        Of `--to`.
    file : str
        That is written.
    """

    name: str
    file: str

    @abstractmethod
    def text(self, found: DiagnosedRobot) -> str:
        """Content of the file."""

    def remarks(self, found: DiagnosedRobot) -> list[str]:
        """What else is not in it as in the robot, a line each."""
        return []


def notes(found: DiagnosedRobot) -> list[str]:
    """What was changed and what has no place in such a model, a line each."""
    lines = [
        f"{each.quantity} of {each.name}: {each.old:.6g} -> {each.new:.6g} {each.unit}"
        for each in found.changes
    ]
    lines += [
        f"torque given for one reported by {name}: 1 -> {gain:.6g}"
        for name, gain in zip(found.robot.joint_names, found.gain, strict=True)
        if gain != 1.0
    ]
    lines += [f"found, but no value of such a model: {each}" for each in found.left_out]
    return lines or ["nothing was found that changes a value"]


MODEL_FORMATS: Registry[ModelFormat] = Registry("stiffopt.export.model_formats")
