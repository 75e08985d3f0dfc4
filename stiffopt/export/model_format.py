"""Diagnosed robots, and the interface and registry of robot formats."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stiffopt.closed_loop.parameters import BODY_PARAMETERS
from stiffopt.discovery.extended.planning import planner_model, read_model
from stiffopt.discovery.extended.schema import ClosedLoopSection
from stiffopt.discovery.extended.value_changes import (
    ValueChange,
    joint_zeros,
    torque_gains,
    value_changes,
)
from stiffopt.discovery.loop_effects import loop_parameter
from stiffopt.discovery.store import MODEL_FILE
from stiffopt.errors import InputFileError
from stiffopt.folders import check_result
from stiffopt.problem.registry import Registry
from stiffopt.recording.recording_set import load_recordings
from stiffopt.robot.robot import Robot

# Places of BODY_PARAMETERS but the mass in `Body.inertial_parameters`.
_BESIDES_MASS = (1, 2, 3, 4, 6, 9)
# Parameters of a closed loop that robot files have no field for.
_UNREPRESENTED_PARAMETERS = (
    "load_friction",
    "friction_slope",
    "drag",
    "offset",
    "lateness",
    "integral",
    "deadband",
)


@dataclass(frozen=True, kw_only=True)
class DiagnosedRobot:
    """Recorded arm with the findings of a diagnosis."""

    name: str  # name of the recording set
    # Nominal robot, and the robot with the findings.
    nominal: Robot
    robot: Robot
    gain: np.ndarray  # (n,) actual over reported drive torque, in the order of the robot's joints
    zeros: np.ndarray  # (n,) position of each joint where its encoder reads 0 [rad]
    # (n,) gains of the joints' position servos [N m/rad], [N m s/rad]; nan where not estimated.
    stiffness: np.ndarray
    damping: np.ndarray
    changes: tuple[ValueChange, ...]
    left_out: tuple[str, ...]  # findings that such a model cannot represent


def read_diagnosed_robot(
    diagnosis: Path, recordings: Path, effects: Path | None = None
) -> DiagnosedRobot:
    """Read extended.toml of a diagnosis and the robot of its recording set.

    `diagnosis`: folder of `stiffopt diagnose`. `recordings`: the recording set. `effects`: file of
    effects outside the catalogue. Raises `InputFileError`: a file is missing, or the set belongs to
    another robot.
    """
    check_result(diagnosis, MODEL_FILE)
    model = read_model(diagnosis / MODEL_FILE, effects)
    loaded = load_recordings(recordings)
    if loaded.joints != model.joints:
        raise InputFileError(
            loaded.path,
            "joints",
            f"the diagnosis has the joints {', '.join(model.joints)}, the set "
            f"{', '.join(loaded.joints)}. Give the diagnosed set.",
        )
    planner = planner_model(loaded.robot, model)
    gain, zeros = np.ones(loaded.robot.n), np.zeros(loaded.robot.n)
    gain[loaded.order] = torque_gains(model)
    zeros[loaded.order] = joint_zeros(model)
    elsewhere = ["torque_gain", "joint_zero"]
    if model.closed_loop is not None:
        # Parameters of the simulation that was fitted, told by their values there.
        parts = [e.located for e in planner.not_in_robot if loop_parameter(e.effect) is not None]
        elsewhere += [each.label for each in parts]
    left_out = tuple(
        each for each in planner.left_out if not each.startswith(tuple(elsewhere))
    ) + tuple(each.label for each in planner.robot.added_torques)
    found = DiagnosedRobot(
        name=model.name,
        nominal=loaded.robot,
        robot=planner.robot,
        gain=gain,
        zeros=zeros,
        stiffness=np.full(loaded.robot.n, np.nan),
        damping=np.full(loaded.robot.n, np.nan),
        changes=tuple(value_changes(loaded.robot, planner.robot, loaded.order)),
        left_out=left_out,
    )
    if model.closed_loop is None:
        return found
    return _with_closed_loop(found, model.closed_loop, np.asarray(loaded.order))


def _with_closed_loop(
    found: DiagnosedRobot, loop: ClosedLoopSection, order: np.ndarray
) -> DiagnosedRobot:
    """Return the robot with the values that its simulation from commands was fitted with.

    They replace those of the search: only together with these gains do they give the recorded
    motion.
    """
    place = np.argsort(order)
    own = {
        name: np.array(values)[place]
        for name, values in loop.values.items()
        if len(values) == len(order)
    }
    robot = replace(
        found.nominal, coulomb=own["coulomb"], viscous=own["viscous"], rotor_inertia=own["armature"]
    )
    for j, body in enumerate(found.nominal.tree.bodies):
        change = own["mass"][j] * body.inertial_parameters
        change[list(_BESIDES_MASS)] += [own[name][j] for name in BODY_PARAMETERS[1:]]
        if change.any():
            robot = robot.with_inertial_parameters(j + 1, body.inertial_parameters + change)
    return replace(
        found,
        robot=robot,
        gain=np.ones(robot.n),
        zeros=-own["zero"],
        stiffness=np.array(loop.stiffness)[place] * (1.0 + own["gain"]),
        damping=np.array(loop.damping)[place] * (1.0 + own["damping"]),
        changes=tuple(value_changes(found.nominal, robot, order)),
        left_out=(
            *found.left_out,
            *(
                f"{name} of joint {j + 1}"
                for name in _UNREPRESENTED_PARAMETERS
                for j in np.flatnonzero(own.get(name, 0.0))  # earlier files have fewer
            ),
        ),
    )


@dataclass(frozen=True, kw_only=True)
class ExportedRobot:
    """Files of an exported robot."""

    files: Mapping[str, str | bytes]
    remarks: tuple[str, ...] = ()  # further differences from the robot, a line each


class ModelFormat(ABC):
    """Format of an exported robot."""

    name: str  # name for `--to`
    file: str  # name of the written file

    @abstractmethod
    def text(self, found: DiagnosedRobot) -> str:
        """Return the content of the file."""

    def export(self, found: DiagnosedRobot) -> ExportedRobot:
        """Return all files, and remarks on them."""
        return ExportedRobot(files={self.file: self.text(found)})


def notes(found: DiagnosedRobot) -> list[str]:
    """Changed values and findings that the model cannot represent, one per line."""
    lines = [
        f"{each.quantity} of {each.name}: {each.old:.6g} -> {each.new:.6g} {each.unit}"
        for each in found.changes
    ]
    lines += [
        f"actual over reported torque of {name}: 1 -> {gain:.6g}"
        for name, gain in zip(found.robot.joint_names, found.gain, strict=True)
        if gain != 1.0
    ]
    lines += [
        f"position of {name} where its encoder reads 0: {zero:.6g} rad"
        for name, zero in zip(found.robot.joint_names, found.zeros, strict=True)
        if zero != 0.0
    ]
    lines += [f"finding without a value in this model: {each}" for each in found.left_out]
    return lines or ["no finding changes a value"]


MODEL_FORMATS: Registry[ModelFormat] = Registry("stiffopt.export.model_formats")
