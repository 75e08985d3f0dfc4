"""What a diagnosis found, as a robot beside its nominal one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.discovery.extended.planning import planner_model, read_model
from stiffopt.discovery.extended.value_changes import ValueChange, torque_gains, value_changes
from stiffopt.discovery.store import MODEL_FILE
from stiffopt.errors import InputFileError
from stiffopt.recording.recording_set import load_recordings
from stiffopt.robot.robot import Robot


@dataclass(frozen=True, kw_only=True)
class FoundRobot:
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


def read_found(diagnosis: Path, recordings: Path, effects: Path | None = None) -> FoundRobot:
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
    return FoundRobot(
        name=model.name,
        nominal=loaded.robot,
        robot=planner.robot,
        gain=gain,
        changes=tuple(value_changes(loaded.robot, planner.robot)),
        left_out=left_out,
    )
