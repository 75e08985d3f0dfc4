"""Tool paths of problem files: segments, and tables of poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import scipy

from stiffopt.dimensions import DIMENSIONS
from stiffopt.errors import InputFileError, ProblemError
from stiffopt.files import read_table
from stiffopt.problem.branches import within_limits
from stiffopt.problem.freedom_choice import ChosenFreedom, choose_freedom
from stiffopt.problem.freedom_task import POSE_JOINTS, FreedomTask
from stiffopt.problem.joint_lists import JointLists
from stiffopt.problem.limit import Limits
from stiffopt.problem.path_force import (
    PathForce,
    check_path_force,
    path_force,
    with_limited_deflection,
)
from stiffopt.problem.schema import (
    PathForceSection,
    PathSection,
    PathSpeedUnit,
    PathTableSection,
    SegmentSection,
)
from stiffopt.problem.tool_path import (
    FittedPath,
    ToolPath,
    ToolSegment,
    fit_tool_path,
    spline_segments,
)
from stiffopt.result.joint_path import JointPath
from stiffopt.robot import frames
from stiffopt.robot.cell import Cell
from stiffopt.robot.elements import locate_errors
from stiffopt.robot.joint_load import supporting_joints
from stiffopt.robot.robot import Robot
from stiffopt.units import convert

_FORCE_COLUMNS = ("fx", "fy", "fz")
_PLACE_COLUMNS, _QUATERNION_COLUMNS = ("x", "y", "z"), ("qx", "qy", "qz", "qw")
_ANGLE_COLUMNS = (("rx", "ry", "rz"), ("roll", "pitch", "yaw"))
# Speed of a tool from which on a table's is in another unit [m/s]: no arm is that fast.
_IMPLAUSIBLE_SPEED = 10.0


@dataclass(frozen=True, eq=False)
class ReadPath:
    """Joint path of a file, the force along it, remarks, and the document of its freedom."""

    joints: JointPath
    force: PathForce | None
    remarks: tuple[str, ...]
    choice: dict[str, Any] | None


def on_positioner(robot: Robot, link: str, process_force: Sequence[float]) -> Robot:
    """Return the robot with its tool relative to a link that carries the work.

    Raises `ProblemError`: the link does not move, or the tool moves it; or what is given in axes of
    the base.
    """
    held = [each.name for each in robot.held]
    if link in frames.link_names(robot.model) and link not in frames.moving_link_names(robot.model):
        raise ProblemError(
            f"the link {link!r} does not move"
            + (f": {', '.join(held)} are held. Give the joints that move it [[joint]] sections of "
               "the robot file, and take them out of `lock`." if held
               else ". Leave path.frame.link out.")
        )  # fmt: skip
    work = frames.link_frame(robot.model, link)
    if robot.tool.joint in supporting_joints(robot.model, work.joint):
        raise ProblemError(
            f"the link {link!r} moves with the tool. Name a link of another branch of the URDF, or "
            "leave path.frame.link out."
        )
    if np.any(process_force):
        raise ProblemError(
            "tool.process_force has axes of the base, and the path those of the work: give the "
            "force in [path.force]."
        )
    if robot.tilts:
        raise ProblemError(
            f"{robot.name} has elastic bearings or links, whose deflection is not taken relative "
            "to moving work: leave `bearing` and `beam` of its joints out."
        )
    return replace(robot, tool=replace(robot.tool, seen_from=work))


def read_tool_path(
    section: PathSection,
    joints: JointLists,
    limits: Limits,
    cell: Cell,
    kept: object = None,
    timing: Callable[[ReadPath], float] | None = None,
) -> ReadPath:
    """Return the joint path of a tool path, its freedom chosen, with its error as a remark.

    `kept` is the document of an earlier choice of the freedom, `timing` the duration [s] of a
    choice.
    """
    robot = joints.robot
    posture = section.near if section.start is None else section.start.near or section.near
    near = None if posture is None else joints(posture, "angle", "path.near")
    with locate_errors(joints.path, ""):
        frame = frames.rotation_from_rpy(section.frame.rpy), np.array(section.frame.position)
        if section.table is not None:
            path, forces, at, names = _table_path(section.table, section, joints.path, frame)
        else:
            path, forces, at, names = _segment_path(section, frame)

        def read(
            path: ToolPath,
            fitted: FittedPath,
            remarks: tuple[str, ...] = (),
            choice: dict[str, Any] | None = None,
        ) -> ReadPath:
            """Return a path that the arm follows, with its force and remarks."""
            force, followed = _force_along(path, section.force, forces, at), fitted.joints
            if force is not None and section.force is not None:
                feeds = np.where(np.isfinite(path.speeds), path.speeds, 0.0)

                def name(along: float) -> str:
                    return names[
                        int(np.clip(np.searchsorted(at, along, "right") - 1, 0, len(names) - 1))
                    ]

                check_path_force(robot, followed, force, float(feeds.max()), path.length, name)
                if section.force.deflection_limit is not None:
                    followed, remark = with_limited_deflection(
                        robot,
                        followed,
                        force,
                        section.force.deflection_limit,
                        section.force.deflection_direction,
                    )
                    remarks = (*remarks, remark)
            stops = f", with {len(path.stops)} stops" if len(path.stops) else ""
            remark = (
                f"The tool's path of {1e3 * path.length:.4g} mm{stops} is followed by a spline "
                f"through {len(followed.knots)} joint waypoints, within "
                f"{1e6 * fitted.error:.2g} µm."
            )
            return ReadPath(followed, force, (remark, *remarks), choice)

        if section.freedom is not None:
            stated = _force_along(path, section.force, forces, at)
            axes = "path" if section.force is None else section.force.frame
            task = FreedomTask(robot, section.freedom, limits, path, frame[1], stated, axes)

            def read_choice(found: ChosenFreedom) -> ReadPath:
                return read(found.path, found.fitted, (found.remark,), found.document)

            return read_choice(
                choose_freedom(
                    task,
                    near,
                    section.tolerance,
                    cell,
                    kept,
                    None if timing is None else lambda found: timing(read_choice(found)),
                )
            )
        fitted = fit_tool_path(within_limits(robot, limits), path, near, section.tolerance)
        remarks: tuple[str, ...] = (fitted.remark,) if fitted.remark else ()
        if robot.n > POSE_JOINTS:
            remarks += (
                f"The arm has {robot.n} joints, and a pose fixes {POSE_JOINTS}: from pose to "
                "pose they turn as little as possible. [path.freedom] chooses them for the "
                "least error or time.",
            )
        return read(path, fitted, remarks)


def _force_along(
    path: ToolPath, stated: PathForceSection | None, forces: np.ndarray, at: np.ndarray
) -> PathForce | None:
    """Return the force along a path with pieces or places (m,) of constant force."""
    if stated is None:
        if np.any(forces):
            raise ProblemError(
                "path.force: the segments or rows of the path state a force, and no section says "
                'in which axes. Add [path.force] with frame = "base", "tool" or "path".'
            )
        return None
    return path_force(path, forces, at, np.array(stated.per_feed), stated.frame, stated.ramp)


Frame = tuple[np.ndarray, np.ndarray]


# A path with its forces (m, 3) [N] on pieces or at places, the distances (m + 1,) or (m,) [m], and
# the names (m,) of the pieces or places.
ForcedPath = tuple[ToolPath, np.ndarray, np.ndarray, list[str]]


def _segment_path(section: PathSection, frame: Frame) -> ForcedPath:
    assert section.start is not None
    turn, origin = frame
    rotation = turn @ frames.rotation_from_rpy(section.start.rpy)
    start = origin + turn @ np.array(section.start.position)
    segments: list[ToolSegment] = []
    at = start
    for number, each in enumerate(section.segment, start=1):
        segment = _segment(each, section, frame, at, number)
        segments.append(segment)
        at = segment.end
    path = ToolPath(start, rotation, segments)
    usual = (0.0, 0.0, 0.0) if section.force is None else section.force.value
    forces = [usual if each.force is None else each.force for each in section.segment]
    return path, np.array(forces), path.segment_ends, [each.where for each in segments]


def _segment(
    each: SegmentSection, section: PathSection, frame: Frame, start: np.ndarray, number: int
) -> ToolSegment:
    turn, origin = frame
    where = f"path.segment[{number}]" + (f" ({each.label})" if each.label else "")
    speeds = [speed for speed in (each.speed, section.speed) if speed is not None]
    speed = min(speeds, default=np.inf)
    end = origin + turn @ np.array(each.to.position)
    curve = None
    if each.via:
        via = origin + np.array(each.via) @ turn.T
        points = np.vstack([start, via, end])
        none = np.zeros(len(points), dtype=bool)
        (spline,) = spline_segments(
            points,
            None,
            np.full(len(points), speed),
            none,
            [f"{where}, point {k}" for k in range(1, len(points) + 1)],
        )
        curve = spline.curve
    return ToolSegment(
        end=end,
        rotation=None if each.to.rpy is None else turn @ frames.rotation_from_rpy(each.to.rpy),
        through=None if each.through is None else origin + turn @ np.array(each.through),
        blend=each.blend,
        curve=curve,
        speed=speed,
        stop=each.stop,
        dwell=each.dwell,
        where=where,
    )


def _table_path(
    table: PathTableSection, section: PathSection, problem: Path, frame: Frame
) -> ForcedPath:
    file = problem.parent / table.file
    groups = (*_ANGLE_COLUMNS, _QUATERNION_COLUMNS, _FORCE_COLUMNS)
    read = read_table(
        file,
        _PLACE_COLUMNS,
        (*(name for group in groups for name in group), "speed", "stop"),
        ("label",),
    )
    for group in groups:
        lacking = [name for name in group if name not in read]
        if 0 < len(lacking) < len(group):
            raise InputFileError(
                file, "", f"lacks the columns {', '.join(lacking)}: {', '.join(group)} belong "
                "together. Add them, or rename those that are there."
            )  # fmt: skip
    given = [group for group in (*_ANGLE_COLUMNS, _QUATERNION_COLUMNS) if group[0] in read]
    if len(given) > 1:
        raise InputFileError(
            file, "", f"has several orientations a row: {', '.join(sum(given, ()))}. Delete or "
            "rename all but one kind."
        )  # fmt: skip
    for columns, kind, unit in (
        (_PLACE_COLUMNS, "length", table.length),
        (sum(_ANGLE_COLUMNS, ()), "angle", table.angle),
    ):
        _check_unit(file, {name: read[name] for name in columns if name in read}, kind, unit)
    turn, origin = frame
    count = len(read["x"])
    metres = convert(1.0, table.length, "m")
    places = metres * np.stack([read[name] for name in _PLACE_COLUMNS], axis=1)
    points = origin + places @ turn.T
    rotations = turn @ _table_rotations(table, read, file, count)
    speeds = np.full(count, np.inf)
    if "speed" in read:
        speed_unit = table.speed or f"{table.length}/s"
        speeds = convert(1.0, speed_unit, "m/s") * np.array(read["speed"])
        for row in np.flatnonzero(~((speeds > 0.0) & (speeds < _IMPLAUSIBLE_SPEED))):
            raise InputFileError(
                file, f"row {row + 1}, speed", f"{read['speed'][row]:g} {speed_unit} must be above "
                f"0 and below {_IMPLAUSIBLE_SPEED:g} m/s. Give its unit as path.table.speed: "
                f"{', '.join(get_args(PathSpeedUnit))}."
            )  # fmt: skip
    if section.speed is not None:
        speeds = np.minimum(speeds, section.speed)
    stops = np.array(read.get("stop", [0.0] * count)) != 0.0
    labels = read.get("label", [""] * count)
    names = [
        f"{table.file}, row {row}" + (f" ({label})" if label else "")
        for row, label in enumerate(labels, start=1)
    ]
    turning = bool(np.ptp(rotations, axis=0).max() > 1e-9)
    usual = (0.0, 0.0, 0.0) if section.force is None else section.force.value
    forces = np.repeat(np.array([usual]), count, axis=0)
    if all(name in read for name in _FORCE_COLUMNS):
        forces = np.stack([read[name] for name in _FORCE_COLUMNS], axis=1)
    if table.interpolation == "spline":
        segments = spline_segments(points, rotations if turning else None, speeds, stops, names)
        path = ToolPath(points[0], rotations[0], segments)
        chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return path, forces, chords * (path.length / chords[-1]), names
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    # Share of the shorter neighbour that a blend between rows of a table takes at most.
    room = 0.45 * np.minimum(steps, np.append(steps[1:], np.inf))
    segments = [
        ToolSegment(
            end=points[k],
            rotation=rotations[k],
            blend=0.0 if stops[k] else float(min(table.blend, room[k - 1])),
            speed=float(speeds[k]),
            stop=bool(stops[k]) and k < count - 1,
            where=names[k],
        )
        for k in range(1, count)
    ]
    path = ToolPath(points[0], rotations[0], segments)
    return path, forces[1:], path.segment_ends, names[1:]


def _check_unit(file: Path, columns: dict[str, list[Any]], kind: str, unit: str) -> None:
    """Raise `InputFileError` for places or angles that are plausible in another of the units."""
    dimension = DIMENSIONS[kind]
    most = dimension.plausible[1]
    smaller = {"length": "mm", "angle": "deg"}[kind]
    for name, values in columns.items():
        size = convert(1.0, unit, dimension.unit) * np.abs(values)
        for row in np.flatnonzero(size > most):
            raise InputFileError(
                file, f"row {row + 1}, {name}", f"{values[row]:g} {unit} is beyond {most:g} "
                f"{dimension.unit}. Give the unit as path.table.{kind}"
                + (f', such as "{smaller}".' if unit != smaller else ", or correct the row.")
            )  # fmt: skip


def _table_rotations(
    table: PathTableSection, read: dict[str, list[Any]], file: Path, count: int
) -> np.ndarray:
    """Return the orientations (m, 3, 3) of a table's rows, in the work frame."""
    if all(name in read for name in _QUATERNION_COLUMNS):
        turns = np.stack([read[name] for name in _QUATERNION_COLUMNS], axis=1)
        sizes = np.linalg.norm(turns, axis=1)
        for row in np.flatnonzero(np.abs(sizes - 1.0) > 1e-2):
            raise InputFileError(
                file, f"row {row + 1}", f"its quaternion has the norm {sizes[row]:.4g}; that of a "
                "rotation is 1. Columns are qw, qx, qy, qz."
            )  # fmt: skip
        return np.asarray(scipy.spatial.transform.Rotation.from_quat(turns).as_matrix())
    named = next((group for group in _ANGLE_COLUMNS if group[0] in read), None)
    if named is not None:
        angles = convert(1.0, table.angle, "rad") * np.stack([read[name] for name in named], axis=1)
        return np.asarray(scipy.spatial.transform.Rotation.from_euler("xyz", angles).as_matrix())
    if table.rpy is None:
        raise InputFileError(
            file, "", "has no orientations: add the columns rx, ry, rz or qw, qx, qy, qz, or give "
            "path.table.rpy for all rows."
        )  # fmt: skip
    return np.repeat(frames.rotation_from_rpy(table.rpy)[None], count, axis=0)
