"""Trajectory problem files: from TOML to a `TrajectoryProblem`."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.declaration import declared
from stiffopt.errors import InputFileError, nearest
from stiffopt.files import read_document
from stiffopt.problem import schema
from stiffopt.problem.joint_lists import JointLists
from stiffopt.problem.limit import LIMITS, Limits
from stiffopt.problem.objective import Objective
from stiffopt.problem.path_files import ReadPath, on_positioner, read_tool_path
from stiffopt.problem.trajectory import (
    Target,
    TrajectoryProblem,
)
from stiffopt.result.duty import DutyLimits
from stiffopt.robot.cell import Cell
from stiffopt.robot.elements import locate_errors
from stiffopt.robot.files import load_robot, shipped_robots
from stiffopt.robot.robot import Robot
from stiffopt.units import convert


@dataclass(frozen=True)
class LoadedProblem:
    """Problem of a file, with the expected value of its solution."""

    problem: TrajectoryProblem
    expected: schema.ExpectedSection | None
    path: Path


def load_problem(
    path: str | os.PathLike[str],
    changes: Sequence[str] = (),
    *,
    robots: Callable[[str | Path], Robot] = load_robot,
    choice: object = None,
    timing: Callable[[TrajectoryProblem], float] | None = None,
) -> LoadedProblem:
    """Read a trajectory problem file.

    `changes` such as "motion.duration=0.5 s" override entries of the file; `robots` loads the robot
    of a name or file, for callers with a cache; `choice` is that of the freedom of a path, as a
    result keeps it; `timing` returns the least duration [s] on the path of a problem, by which a
    path's freedom is chosen where the time is minimised.
    """
    path = Path(path)
    document = read_document(path, schema.problem_file(), "trajectory", changes)
    with locate_errors(path, ""):
        problem = _build_problem(document, path, robots, choice, timing)
    check_expected_unit(document.expected, problem.objectives, path)
    return LoadedProblem(problem, document.expected, path)


def check_expected_unit(
    expected: schema.ExpectedSection | None, objectives: Sequence[Objective], path: Path
) -> None:
    """Raise `InputFileError` where the expected value is in no unit of a single objective."""
    if expected is not None and len(objectives) == 1:
        with locate_errors(path, "expected.unit"):
            convert(1.0, objectives[0].unit, expected.unit)


def _build_problem(
    document: schema.ProblemFile,
    path: Path,
    robots: Callable[[str | Path], Robot],
    choice: object,
    timing: Callable[[TrajectoryProblem], float] | None,
) -> TrajectoryProblem:
    if document.move:
        raise InputFileError(
            path,
            "move",
            "the file is a cycle of several moves, which `stiffopt solve`, `verify` and `export` "
            "take. Leave [[move]] out for a single motion from motion.start to motion.end.",
        )
    if document.motion.error_limit is not None:
        raise InputFileError(
            path, "motion.error_limit", "belongs to a cycle of [[move]]. Leave it out."
        )
    robot = read_robot(document.robot, document.payload, document.tool, path, robots)
    if document.path is not None and document.path.frame.link is not None:
        with locate_errors(path, "path.frame.link"):
            robot = on_positioner(robot, document.path.frame.link, document.tool.process_force)
    motion = document.motion
    joints = JointLists(robot, path)
    poses = PoseReader(joints, document.pose)
    remarks = payload_remarks(document.payload)
    fields = common_fields(document, joints)
    velocity = None
    if motion.boundary_velocity != "zero":
        velocity = (
            joints(motion.boundary_velocity.start, "angular velocity", "boundary_velocity.start"),
            joints(motion.boundary_velocity.end, "angular velocity", "boundary_velocity.end"),
        )

    def stated(start: Target, end: Target, own: dict[str, Any]) -> TrajectoryProblem:
        return TrajectoryProblem(
            robot=robot,
            start=start,
            end=end,
            vias=tuple(poses(via, f"motion.via[{k}]") for k, via in enumerate(motion.via, start=1)),
            duration=read_duration(document),
            boundary_velocity=velocity,
            boundary_acceleration=motion.boundary_acceleration,
            duty=None
            if document.duty == schema.DutySection()
            else read_duty(document.duty, joints),
            **{**fields, "remarks": remarks, **own},
        )

    def along(found: ReadPath) -> TrajectoryProblem:
        own: dict[str, Any] = {
            "path": found.joints,
            "path_force": found.force,
            "path_choice": found.choice,
            "remarks": (*remarks, *found.remarks),
        }
        if found.joints.speeds is not None:
            limits: Limits = fields["limits"]
            fastest = min(limits.tool_speed, float(found.joints.speeds.max()))
            own["limits"] = Limits({**limits.values, "tool_speed": fastest})
        start, end = (Target(joints=found.joints.points[k]) for k in (0, -1))
        return stated(start, end, own)

    if motion.path is not None:
        # An array of waypoints becomes a path when the problem is checked.
        waypoints = np.stack(
            [joints(q, "angle", f"motion.path[{k}]") for k, q in enumerate(motion.path, start=1)]
        )
        ends = Target(joints=waypoints[0]), Target(joints=waypoints[-1])
        return stated(*ends, {"path": waypoints})
    if document.path is not None:
        if motion.start is not None:
            raise InputFileError(
                path, "path", "fixes the motion of the tool. Remove start, via and end of [motion]."
            )
        cell = fields["cell"] or Cell()
        judge = None if timing is None else lambda found: timing(along(found))
        return along(read_tool_path(document.path, joints, fields["limits"], cell, choice, judge))
    if motion.start is None or motion.end is None:
        raise InputFileError(
            path, "motion", "give `start` and `end`, or a fixed joint `path`, or a [path] of "
            "the tool, or `start` and the [[move]] of a cycle."
        )  # fmt: skip
    start = poses(motion.start, "motion.start")
    return stated(start, poses(motion.end, "motion.end"), {})


def read_duration(document: schema.ProblemFile) -> tuple[float, float]:
    """Lower and upper duration [s] of a file; equal where it is fixed."""
    duration = document.motion.duration
    if isinstance(duration, float):
        return duration, duration
    return duration.lower, np.inf if duration.upper is None else duration.upper


def common_fields(document: schema.ProblemFile, joints: JointLists) -> dict[str, Any]:
    """Fields of `TrajectoryProblem` that a single motion and every leg of a cycle share."""
    limits = _read_limits(document.limits, joints)
    return {
        "objectives": tuple(
            Objective(
                name=term.objective, **{key: getattr(term, key) for key in declared(Objective)}
            )
            for term in document.minimise or ()
        ),
        "limits": limits,
        "process_force": np.array(document.tool.process_force),
        "method": document.method,
        "uncertainty": document.uncertainty,
        "servo": document.servo,
        "tolerances": document.tolerances,
        "title": document.title or joints.path.stem,
        "cell": None if document.cell is None else document.cell.found_in(joints.path.parent),
    }


def read_duty(section: schema.DutySection, joints: JointLists) -> DutyLimits:
    """Limits of the duty of a file."""

    def by_joint(name: str) -> np.ndarray | None:
        given = getattr(section, name)
        return None if given is None else joints(given, "torque", f"duty.{name}")

    return DutyLimits(
        rms_torque=by_joint("rms_torque"),
        mean_torque=by_joint("mean_torque"),
        reducer_life=section.reducer_life,
        energy=section.energy,
    )


def payload_remarks(payload: schema.PayloadSection | None) -> tuple[str, ...]:
    """Assumptions about the payload, repeated in results."""
    if payload is None or payload.inertia is not None or payload.mass == 0.0:
        return ()
    return (
        f"The payload of {payload.mass:g} kg has no inertia: a point mass at its centre of mass is "
        "assumed. Give payload.inertia.",
    )


def read_robot(
    name: str,
    payload: schema.PayloadSection | None,
    tool: schema.ToolPointSection,
    path: Path,
    robots: Callable[[str | Path], Robot] = load_robot,
) -> Robot:
    """Robot of a problem or study file `path`, with the file's payload and tool."""
    beside = path.parent / name
    source = name if name in shipped_robots() else beside if beside.exists() else name
    with locate_errors(path, "robot"):
        robot = robots(source)
    if payload is not None:
        with locate_errors(path, "payload"):
            robot = robot.with_payload(payload.mass, payload.com, payload.inertia)
    if tool.link is not None or tool.offset is not None or tool.rpy is not None:
        with locate_errors(path, "tool"):
            robot = robot.with_tool(tool.link, tool.offset, tool.rpy)
    return robot


class PoseReader:
    """Targets of a file, with those of [[pose]] by their names."""

    def __init__(self, joints: JointLists, poses: Sequence[schema.PoseSection]) -> None:
        self._joints, self.named = joints, {each.name: each for each in poses}
        for number, each in enumerate(poses, start=1):
            if self.named[each.name] is not each:
                raise InputFileError(
                    joints.path, f"pose[{number}]", f"{each.name!r} is the name of two poses. "
                    "Rename one."
                )  # fmt: skip

    def __call__(self, section: schema.NamedTarget, where: str) -> Target:
        """Target of an entry at the key `where`."""
        if isinstance(section, str):
            if section not in self.named:
                known = nearest(section, self.named) if self.named else "The file has no [[pose]]."
                raise InputFileError(
                    self._joints.path, where, f"there is no pose {section!r}. {known}"
                )
            where, section = f"pose[{section}]", self.named[section]

        def angles(values: Sequence[float] | None, key: str) -> np.ndarray | None:
            return None if values is None else self._joints(values, "angle", f"{where}.{key}")

        extra = {} if section.tolerance is None else {"tolerance": float(section.tolerance)}
        with locate_errors(self._joints.path, where):
            return Target(
                joints=angles(section.joints, "joints"),
                position=None if section.position is None else np.array(section.position),
                rpy=None if section.rpy is None else np.array(section.rpy),
                near=angles(section.near, "near"),
                angle_tolerance=section.angle_tolerance,
                **extra,
            )


def _read_limits(section: schema.LimitsSection, joints: JointLists) -> Limits:
    values: dict[str, Any] = {}
    for kind in LIMITS.values():
        values |= kind.read(section, joints)
    return Limits(values)
