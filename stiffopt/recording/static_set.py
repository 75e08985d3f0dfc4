"""Static set: poses with a known force and the measured displacement of the tool."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputFileError, UnitError
from stiffopt.files import load_toml, read_document
from stiffopt.recording import recorded_arm
from stiffopt.recording.nominal_files import per_joint
from stiffopt.recording.readers.read import read_named_columns
from stiffopt.recording.schema import StaticFile
from stiffopt.recording.signals import entries_of_columns, unit_factor
from stiffopt.recording.stated_units import BRACKET_PATTERN, stated_unit
from stiffopt.units import to_si

STATIC_FILE = "static.toml"


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticSet(recorded_arm.RecordedArm):
    """Measured deflections of an arm at rest."""

    tool_frame: str
    position: np.ndarray  # (m, n) [rad]
    force: np.ndarray  # (m, 3) force on the tool, base frame [N]
    displacement: np.ndarray  # (m, 3) displacement of the tool, base frame [m]
    difference: bool  # each line is the difference of two load states, without gravity
    stiffness: np.ndarray | None  # (n,) nominal joint stiffness [N m/rad]


def is_static(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a static set: its folder, or a file of its name or kind."""
    path = Path(path)
    if path.is_dir():
        return (path / STATIC_FILE).is_file()
    return path.name == STATIC_FILE or (path.is_file() and load_toml(path).get("kind") == "static")


def load_static_set(path: str | os.PathLike[str], changes: Sequence[str] = ()) -> StaticSet:
    """Load a static set by its folder or static.toml, with `changes` of entries."""
    path = Path(path)
    if path.is_dir():
        path = path / STATIC_FILE
    document = read_document(path, StaticFile, "static", changes)
    n = len(document.joints)
    if len(document.position) != n:
        raise InputFileError(
            path,
            "position",
            f"needs one column a joint ({n}), got {len(document.position)}.",
        )
    robot, locked = recorded_arm.load_arm(
        document.robot, document.joints, path, document.tool_frame, document.gravity
    )
    columns = (*document.position, *document.force, *document.displacement)
    if len(set(columns)) < len(columns):
        raise InputFileError(path, "", "one column is named for two quantities. Correct the names.")
    poses = recorded_arm.path_inside_set(path, "poses", document.poses)
    table = read_named_columns(poses, columns)
    for name in columns:
        for place in np.flatnonzero(~np.isfinite(table[name])):
            raise InputFileError(
                poses,
                f"row {place + 1}, {name}",
                "needs a finite number. Complete or delete the row.",
            )
    order = recorded_arm.joint_order(robot, document.joints)
    angles = ["length" if slides else "angle" for slides in robot.prismatic[order]]
    position, force, displacement = (
        np.column_stack(
            [
                table[name] * factor
                for name, factor in zip(names, _factors(names, of, entry, path, key), strict=True)
            ]
        )
        for key, names, of, entry in (
            ("position", document.position, angles, document.scale.position),
            ("force", document.force, ["force"] * 3, document.scale.force),
            ("displacement", document.displacement, ["length"] * 3, document.scale.displacement),
        )
    )
    if not force.any(axis=1).all():
        row = int(np.flatnonzero(~force.any(axis=1))[0]) + 1
        raise InputFileError(
            poses, f"row {row}", "a pose without a force says nothing of stiffness. Delete it."
        )
    # Ranges of a URDF are often approximate, and encoders may be off by a turn.
    recorded_arm.check_range(poses, robot, position[:, np.argsort(order)], slack=2.0 * np.pi)
    return StaticSet(
        **recorded_arm.describe_arm(document, path),
        robot=robot,
        locked=locked,
        tool_frame=document.tool_frame,
        position=position,
        force=force,
        displacement=displacement,
        difference=document.difference,
        stiffness=per_joint(document.nominal.stiffness, n, path, "nominal.stiffness"),
    )


def _factors(
    names: Sequence[str], dimensions: Sequence[str], entry: Any, path: Path, key: str
) -> list[float]:
    """Return the factors to SI of columns, by [scale], else by the units that their names state."""
    where = key if entry is None else f"scale.{key}"
    if entry is None:
        entry = tuple(_unit_of_name(name, of) for name, of in zip(names, dimensions, strict=True))
    return [
        1.0 if own == "" else unit_factor(own, dimension, path, where, to_si)
        for own, dimension in zip(
            entries_of_columns(entry, len(names), path, where), dimensions, strict=True
        )
    ]


def _unit_of_name(name: str, dimension: str) -> str:
    """Return the unit that a name states, "" for SI; loggers' own abbreviations take precedence."""
    stated = stated_unit(name)
    content = BRACKET_PATTERN.search(name)
    if stated is not None or content is None:
        return stated or ""
    try:
        to_si(f"1 {content[1]}", dimension)
    except UnitError:  # an entry of a vector, such as force[x]
        return ""
    return content[1]
