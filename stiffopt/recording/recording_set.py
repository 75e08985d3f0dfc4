"""Recording set: recordings of a robot and its nominal model."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from stiffopt.actuator.law import ActuatorLaw
from stiffopt.actuator.position_servo import PositionServo
from stiffopt.errors import InputFileError
from stiffopt.files import apply_changes, check_schema, load_toml
from stiffopt.recording import recorded_arm
from stiffopt.recording.clean import clean_run
from stiffopt.recording.nominal import Noise, Nominal, Tolerance
from stiffopt.recording.nominal_files import (
    assumptions,
    build_noise,
    build_nominal,
    build_nominal_robot,
    missing_nominal_values,
    nominal_assumptions,
    per_joint,
)
from stiffopt.recording.readers.read import find_set_file, read_columns
from stiffopt.recording.run import RecordedRun, Role, derive_torque
from stiffopt.recording.schema import NominalSection, RecordingsFile, RunSection
from stiffopt.recording.signals import Signals, build_signals
from stiffopt.robot.elements import locate_errors
from stiffopt.robot.robot import Robot
from stiffopt.validation import validate


@dataclass(frozen=True, kw_only=True, eq=False)
class RunEntry:
    """Entry of a run in a set; its file is not read yet."""

    file: str
    role: Role  # "train", "test" or "extrapolate"
    session_time: float | None  # time since the robot was switched on [s]
    number: int  # place in the set, from 0
    # (n,) temperature of the housings at the start of the run [degC].
    temperature: np.ndarray | None

    @property
    def name(self) -> str:
        """File name without ending, with the number of the episode where given."""
        path = PurePosixPath(self.file)
        name, mark, episode = path.name.rpartition("#")
        return f"{PurePosixPath(name).stem}_{episode}" if mark and name else path.stem


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordingSet(recorded_arm.RecordedArm):
    """Recordings of one robot and the nominal model of its simulation."""

    tool_frame: str | None
    gravity: np.ndarray  # (3,) [m/s^2]
    signals: Signals
    described: Robot  # robot of its own file, without the values of the set
    stated: NominalSection  # nominal values that the set gives
    nominal: Nominal
    tolerance: Tolerance
    noise: Noise
    runs: tuple[RunEntry, ...]
    # Assumptions in place of entries that the set does not give, one sentence each.
    assumptions: tuple[str, ...]
    actuator: ActuatorLaw | None = None  # of a set without torques

    @property
    def torque_side(self) -> str:
        """Side of the torque measurement: "motor" or "link"."""
        return self.signals.torque_side

    @property
    def swings(self) -> bool:
        """Return whether stiffness and damping of all joints are known, for elastic simulation."""
        chains = self.robot.chains
        sprung = all(chain is not None and bool(chain.stages) for chain in chains)
        return sprung and self.nominal.joint_damping is not None

    @property
    def unstated(self) -> tuple[str, ...]:
        """Keys of coulomb, viscous, rotor_inertia that neither the set nor its robot file gives."""
        return missing_nominal_values(self.stated, self.described)

    def with_nominal(self, stated: NominalSection, path: str | os.PathLike[str]) -> RecordingSet:
        """Recording set with other nominal values, from the file at `path`.

        Assumptions on the nominal values of the set itself are removed.
        """
        path = Path(path)
        links = bool(self.signals.link_position)
        silent = nominal_assumptions(self.stated, self.tolerance, self.described, links=links)
        return replace(
            self,
            robot=build_nominal_robot(self.described, self.order, stated, path),
            nominal=build_nominal(stated, self.joints, path),
            stated=stated,
            assumptions=tuple(each for each in self.assumptions if each not in silent),
        )

    def with_actuator(self, law: ActuatorLaw) -> RecordingSet:
        """Recording set with a law that derives torques from commands."""
        return replace(self, actuator=law)

    def with_role(self, *roles: Role) -> tuple[RunEntry, ...]:
        """Entries of the runs of these roles, in the order of the set."""
        return tuple(entry for entry in self.runs if entry.role in roles)

    def open(self, entry: RunEntry) -> RecordedRun:
        """Read and clean one run.

        Raises `InputFileError`: a file that is missing or has other columns, a clock that runs
        backwards, too few samples.
        """
        path = recorded_arm.path_inside_set(self.path, "runs", entry.file)
        columns = self.signals.to_si(read_columns(path, self.signals))
        run = clean_run(
            columns,
            self.signals,
            path=path,
            name=entry.name,
            file=entry.file,
            role=entry.role,
            session_time=entry.session_time,
            number=entry.number,
            temperature=entry.temperature,
            prismatic=self.prismatic,
        )
        return self.derive_torque(run)

    def derive_torque(self, run: RecordedRun) -> RecordedRun:
        """Return a run with the torques of the actuators' law in place of missing ones."""
        bodies, order = self.robot.bodies_in_motion(), self.order

        def weight(position: np.ndarray) -> np.ndarray:
            still = np.zeros_like(position)
            return np.asarray(bodies.torque(position[:, np.argsort(order)], still, still)[:, order])

        return derive_torque(run, self.actuator, weight)


def load_recordings(path: str | os.PathLike[str], changes: Sequence[str] = ()) -> RecordingSet:
    """Load a recording set by its folder or recordings.toml, without its run files.

    `changes` such as "noise.torque=0.5" replace entries of the file.
    """
    path = find_set_file(Path(path))
    data = apply_changes(load_toml(path), changes, path)
    check_schema(data, path)
    document = validate(RecordingsFile, data, path)
    n = len(document.joints)
    described, locked = recorded_arm.load_arm(
        document.robot, document.joints, path, document.tool_frame, document.gravity
    )
    order = recorded_arm.joint_order(described, document.joints)
    signals = build_signals(document.signals, n, path)
    actuator = _build_actuator(document, signals, _torque_limits(described)[order], path)
    if actuator is not None and not actuator.damping_stated:
        # The drives damp besides: no nominal value tells what a joint loses to its velocity.
        described = replace(described, viscous=np.zeros(described.n))
        nominal = document.nominal.model_copy(update={"viscous": None})
        document = document.model_copy(update={"nominal": nominal})
    stated = document.nominal
    robot = build_nominal_robot(described, order, stated, path)
    tolerance = document.tolerance
    noise = build_noise(document.noise, n, path)
    runs = tuple(
        _run_entry(section, n, number, path) for number, section in enumerate(document.runs)
    )
    _check_names(runs, path)
    return RecordingSet(
        **recorded_arm.describe_arm(document, path),
        robot=robot,
        locked=locked,
        tool_frame=document.tool_frame,
        gravity=described.tree.gravity,
        signals=signals,
        described=described,
        stated=stated,
        nominal=build_nominal(stated, document.joints, path),
        tolerance=tolerance,
        noise=noise,
        runs=runs,
        assumptions=assumptions(document, described, locked),
        actuator=actuator,
    )


def _torque_limits(robot: Robot) -> np.ndarray:
    """Return the largest torques (n,) of the drives; infinite where the robot's are guesses."""
    guessed = {
        each.joint
        for each in robot.sources
        if each.key == "torque_max" and each.provenance == "estimated"
    }
    return np.where([name in guessed for name in robot.joint_names], np.inf, robot.torque_max)


def _build_actuator(
    document: RecordingsFile, signals: Signals, torque_max: np.ndarray, path: Path
) -> ActuatorLaw | None:
    """Return the law that gives torques from commands; None for a set with torques."""
    if document.actuator is not None and signals.command is None:
        raise InputFileError(
            path, "actuator", "needs commanded positions: name their columns as signals.command."
        )
    if not signals.commanded:
        return None
    kind = document.actuator or PositionServo(kind="position_servo")
    with locate_errors(path, "actuator"):
        return kind.law(torque_max)


def require_test_runs(recordings: RecordingSet) -> None:
    """Raise `InputFileError` without training runs or without test runs."""
    purposes = {
        "train": "The model is fitted to runs of this role",
        "test": "A fit is judged only on runs that it was not fitted to",
    }
    for role, purpose in purposes.items():
        if not any(entry.role == role for entry in recordings.runs):
            roles = ", ".join(f"{entry.file}: {entry.role}" for entry in recordings.runs)
            raise InputFileError(
                recordings.path,
                "runs",
                f'none of the {len(recordings.runs)} runs has role = "{role}" ({roles}). '
                f"{purpose}: mark or record at least one.",
            )


def require_usable(recordings: RecordingSet, usable: Set[str]) -> None:
    """Raise `InputFileError` without usable training runs or usable test runs."""
    require_test_runs(recordings)
    for role in ("train", "test"):
        files = [entry.file for entry in recordings.with_role(role)]
        if usable.isdisjoint(files):
            raise InputFileError(
                recordings.path,
                "runs",
                f'no run of the role "{role}" can be used: in {", ".join(files)} a joint has no'
                " position that can be trusted. Record again, or give other runs that role.",
            )


def _run_entry(section: RunSection, n: int, number: int, path: Path) -> RunEntry:
    recorded_arm.path_inside_set(path, f"runs[{number + 1}].file", section.file)
    return RunEntry(
        file=section.file,
        role=section.role,
        session_time=section.session_time,
        number=number,
        temperature=per_joint(
            section.housing_temperature, n, path, f"runs[{number + 1}].housing_temperature"
        ),
    )


def _check_names(runs: tuple[RunEntry, ...], path: Path) -> None:
    seen: dict[str, int] = {}
    for number, entry in enumerate(runs, start=1):
        if re.search(r"[\\\x00-\x1f\x7f-\x9f]", entry.name):
            raise InputFileError(
                path,
                f"runs[{number}].file",
                f"{entry.file!r} has a backslash or control character in its name, under which "
                "results are filed: rename it.",
            )
        if entry.name in seen:
            raise InputFileError(
                path,
                f"runs[{number}].file",
                f"{entry.file!r} has the name of run {seen[entry.name]}. Results are filed under "
                "the name without its ending: rename one.",
            )
        seen[entry.name] = number
