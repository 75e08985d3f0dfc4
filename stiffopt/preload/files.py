"""Preload study files: from TOML to a `PreloadProblem`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.drivetrain.tables import with_own
from stiffopt.dynamics.inverse_kinematics import solve_pose
from stiffopt.errors import InputFileError, nearest
from stiffopt.fastening.limits import check_preload
from stiffopt.files import apply_changes, load_toml, read_document
from stiffopt.path.load import load_problem
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.preload.load_sources import pose_case, trajectory_history
from stiffopt.preload.problem import PreloadProblem
from stiffopt.preload.schema import (
    ExpectedValueSection,
    LoadCaseSection,
    PreloadFile,
    StudyMotionSection,
)
from stiffopt.preload.study import value_units
from stiffopt.problem.files import read_robot
from stiffopt.problem.joint_lists import JointLists
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.robot.elements import locate_errors
from stiffopt.robot.files import load_own_entries
from stiffopt.robot.frames import rotation_from_rpy
from stiffopt.robot.robot import Robot
from stiffopt.units import convert, fit_joint


@dataclass(frozen=True, kw_only=True)
class LoadedStudy:
    """Preload study file: the problem and the settings beside it."""

    problem: PreloadProblem
    # By name: expected results of a verification; names as in `value_units`.
    expected: Mapping[str, ExpectedValueSection]
    path: Path
    front_points: int  # of the Pareto front; 0 leaves it out
    motion: TrajectoryProblem | None  # optimised together with the preloads
    rounds: int  # largest number of rounds of the joint study


def load_study(path: str | os.PathLike[str], changes: Sequence[str] = ()) -> LoadedStudy:
    """Read a preload study file.

    `changes` such as "motion.duration=0.5 s" override entries of the file.
    """
    path = Path(path)
    named = apply_changes(load_toml(path), changes, path).get("robot")
    with with_own(load_own_entries(named, path.parent)):
        document = read_document(path, PreloadFile, "preload", changes)
        robot = read_robot(document.robot, document.payload, document.tool, path)
        with locate_errors(path, ""):
            problem = _build_problem(document, robot, path)
        _check_present_preloads(problem, path)
        motion, rounds = None, 1
        if document.motion is not None:
            motion, rounds = _load_motion(document.motion, robot, path), document.motion.rounds
        _check_expected(document, problem, motion is not None, path)
        return LoadedStudy(
            problem=problem,
            expected=dict(document.expected.values),
            path=path,
            front_points=document.pareto.points,
            motion=motion,
            rounds=rounds,
        )


def _build_problem(document: PreloadFile, robot: Robot, path: Path) -> PreloadProblem:
    lists = JointLists(robot, path)
    joints = document.joints
    if joints is None:
        joints = [j for j, chain in enumerate(robot.chains, start=1) if chain is not None]
    for joint in joints:
        lists.check_number(joint, "joints")
    objective, needs = document.minimise[0], document.require
    stiffness = _stiffness_by_joint(needs.joint_stiffness, lists, "require.joint_stiffness")
    wanted = objective.objective == "tool_deflection" or needs.tool_deflection is not None
    builder = _LoadCases(document, lists, wanted, _needs_wrench(document, robot, joints))
    loads = [builder(case, k) for k, case in enumerate(document.load_case, start=1)]
    if wanted:
        builder.check_deflection(loads)
    return PreloadProblem(
        robot=robot,
        joints=tuple(joints),
        load_cases=tuple(load for load in loads if isinstance(load, LoadCase)),
        histories=tuple(load for load in loads if isinstance(load, LoadHistory)),
        tightening=document.tightening,
        objective=objective.objective,
        joint_weights=_stiffness_by_joint(
            objective.joint_weights, lists, "minimise[1].joint_weights"
        ),
        requirements=replace(needs, joint_stiffness=stiffness),
        free=document.free,
        individual=document.individual,
        choose=document.choose,
        title=document.title or path.stem,
    )


def _needs_wrench(document: PreloadFile, robot: Robot, joints: Sequence[int]) -> bool:
    """Return True if a flange of the study carries more than torque."""
    return any(
        isinstance(stage.element, BoltedFlange)
        and stage.element.bearing == "none"
        and stage.ratio == 1.0
        and (not document.free or stage.element.name in document.free)
        for joint in joints
        if (chain := robot.chains[joint - 1]) is not None
        for stage in chain.stages
    )


class _LoadCases:
    """Conversion of load case sections of a file to load cases."""

    def __init__(self, document: PreloadFile, lists: JointLists, wanted: bool, whole: bool) -> None:
        self.whole = whole
        self.lists, self.robot, self.path = lists, lists.robot, lists.path
        self.deflection, self.wanted = document.deflection, wanted
        self.force = document.tool.process_force

    def __call__(self, section: LoadCaseSection, number: int) -> LoadCase | LoadHistory:
        where = f"load_case[{section.name or number}]"
        if section.torque is not None:
            return self._torque_case(section, where)
        with locate_errors(self.path, where):
            force = np.array(self.force if section.force is None else section.force)
            if section.trajectory is not None:
                return trajectory_history(
                    self.robot,
                    section.name,
                    self.path.parent / section.trajectory,
                    force,
                    self.deflection if self.wanted else None,
                    self.whole,
                )
            angles = self._read_pose(section, where)
            return pose_case(self.robot, section.name, angles, force, self.deflection)

    def check_deflection(self, loads: list[LoadCase | LoadHistory]) -> None:
        """Raise `InputFileError` if no load case deflects the tool beyond the static sag."""
        for load in loads:
            reference, jacobian = load.reference_torque, load.jacobian
            if jacobian is not None and (
                reference is None or not np.array_equal(reference, load.torque)
            ):
                return
        allowed = {
            "total": "a trajectory or a pose",
            "dynamic": "a trajectory: at rest there is no dynamic deflection",
            "process": "a trajectory or a pose with a `force`",
        }
        raise InputFileError(
            self.path,
            "load_case",
            f"no load case gives the tool a {self.deflection} deflection. Give "
            f"{allowed[self.deflection]}; joint torques alone do not determine it.",
        )

    def _torque_case(self, section: LoadCaseSection, where: str) -> LoadCase:
        assert section.torque is not None
        torque = self.lists(section.torque, "torque", f"{where}.torque")
        for j in np.flatnonzero(torque < 0):
            raise InputFileError(
                self.path,
                f"{where}.torque[{j + 1}]",
                f"got {torque[j]:g}, allowed is 0 or above. Slip and stiffness do not depend on "
                "the direction: give the magnitude.",
            )
        beside = {
            "axial_force": section.axial_force,
            "shear_force": section.shear_force,
            "tilting_moment": section.tilting_moment,
        }
        return LoadCase(
            name=section.name,
            torque=torque,
            wrench=self._worst_wrench(torque, beside, where) if any(beside.values()) else None,
            reversing=np.full(len(torque), True) if section.reversing else None,
        )

    def _worst_wrench(
        self, torque: np.ndarray, beside: Mapping[str, Sequence[float] | None], where: str
    ) -> np.ndarray:
        """Return joint loads (n, 6) from magnitudes, all least favourable at one bolt."""
        wrench = np.zeros((len(torque), 6))
        wrench[:, 5] = torque
        # A moment about x loads the bolt on the y axis most, where torque forces act along -x.
        for column, sign, key in (
            (2, 1, "axial_force"),
            (0, -1, "shear_force"),
            (3, 1, "tilting_moment"),
        ):
            given = beside[key]
            if given is None:
                continue
            if len(given) != len(torque) or min(given) < 0:
                raise InputFileError(
                    self.path,
                    f"{where}.{key}",
                    f"needs one number of 0 or above a joint, {len(torque)}. Give the magnitudes.",
                )
            wrench[:, column] = sign * np.asarray(given, dtype=float)
        return wrench

    def _read_pose(self, section: LoadCaseSection, where: str) -> np.ndarray:
        if section.joints is not None:
            angles = self.lists(section.joints, "angle", f"{where}.joints")
        else:
            near = section.near and self.lists(section.near, "angle", f"{where}.near")
            turn = None if section.rpy is None else rotation_from_rpy(section.rpy)
            angles = solve_pose(self.robot, section.position, turn, near)
        low, high = self.robot.position_lower, self.robot.position_upper
        for j in np.flatnonzero((angles < low - 1e-9) | (angles > high + 1e-9)):
            raise InputFileError(
                self.path,
                f"{where}.joints[{j + 1}]",
                f"{angles[j]:.4g} is outside the range of joint {j + 1}, {low[j]:.4g} to "
                f"{high[j]:.4g}. Choose a pose within the range.",
            )
        return angles


def _stiffness_by_joint(
    values: Mapping[int, float], lists: JointLists, where: str
) -> dict[int, float]:
    found = {}
    for joint, value in values.items():
        lists.check_number(joint, where)
        with locate_errors(lists.path, where):
            name = lists.names[joint - 1]
            found[joint] = fit_joint(value, bool(lists.prismatic[joint - 1]), "stiffness", name)
    return found


def _check_present_preloads(problem: PreloadProblem, path: Path) -> None:
    """Raise `InputError` if a present preload exceeds its limit."""
    for element in problem.elements:
        with locate_errors(path, f"robot, joint {element.joint}"):
            check_preload(element.stage.element, problem.tightening)


def _load_motion(section: StudyMotionSection, robot: Robot, path: Path) -> TrajectoryProblem:
    with locate_errors(path, "motion.problem"):
        motion = load_problem(path.parent / section.problem).problem
    if motion.robot.name != robot.name:
        raise InputFileError(
            path,
            "motion.problem",
            f"is of robot {motion.robot.name}, the study of {robot.name}. Give a trajectory "
            "problem of the same robot.",
        )
    if section.intervals is not None:
        motion = replace(motion, method=replace(motion.method, intervals=section.intervals))
    return motion


def _check_expected(
    document: PreloadFile, problem: PreloadProblem, motion: bool, path: Path
) -> None:
    units = value_units(problem, front=document.pareto.points > 0, motion=motion)
    for name, expected in document.expected.values.items():
        where = f"expected.values.{name}"
        if name not in units:
            raise InputFileError(
                path, where, f"the study has no value {name!r}. {nearest(name, units)}"
            )
        with locate_errors(path, f"{where}.unit"):
            convert(1.0, units[name], expected.unit)
