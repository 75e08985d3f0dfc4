"""Static set: poses with a known force and the measured displacement of the tool."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import load_toml, read_document, read_table
from stiffopt.recording.nominal_files import per_joint
from stiffopt.recording.recorded_arm import RecordedArm, describe_arm, load_arm, path_inside_set
from stiffopt.recording.schema import StaticFile

STATIC_FILE = "static.toml"


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticSet(RecordedArm):
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
    robot, locked = load_arm(
        document.robot, document.joints, path, document.tool_frame, document.gravity
    )
    columns = (*document.position, *document.force, *document.displacement)
    if len(set(columns)) < len(columns):
        raise InputFileError(path, "", "one column is named for two quantities. Correct the names.")
    poses = path_inside_set(path, "poses", document.poses)
    table = read_table(poses, columns)
    force = np.column_stack([table[name] for name in document.force])
    if not force.any(axis=1).all():
        row = int(np.flatnonzero(~force.any(axis=1))[0]) + 1
        raise InputFileError(
            poses, f"row {row}", "a pose without a force says nothing of stiffness. Delete it."
        )
    return StaticSet(
        **describe_arm(document, path),
        robot=robot,
        locked=locked,
        tool_frame=document.tool_frame,
        position=np.column_stack([table[name] for name in document.position]),
        force=force,
        displacement=np.column_stack([table[name] for name in document.displacement]),
        difference=document.difference,
        stiffness=per_joint(document.nominal.stiffness, n, path, "nominal.stiffness"),
    )
