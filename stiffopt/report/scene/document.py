"""What the browser draws: the arm, its motions and the parts of the deflection, as plain data."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import plain
from stiffopt.report.scene.mesh import compact_mesh
from stiffopt.report.scene.poses import Poses
from stiffopt.report.scene.surroundings import shapes_around
from stiffopt.robot.link_shapes import JointShape
from stiffopt.robot.skeleton import capsules, joint_radii, reach

if TYPE_CHECKING:
    from stiffopt.robot.cell import Cell
    from stiffopt.robot.robot import Robot

# Of all meshes of an arm together, so that a page stays below 3 MB.
_MAX_ARM_TRIANGLES = 60000


def scene_document(
    robot: Robot,
    motions: Mapping[str, Poses],
    part: str,
    factor: float,
    cell: Cell | None = None,
) -> dict[str, Any]:
    """Content of a scene.

    Parameters
    ----------
    robot : Robot
    motions : mapping of name to Poses
        The one that is shown first, then its ghost.
    part : str
        Of the deflection that is shown at first.
    factor : float
        By which it is enlarged at first.
    cell : Cell, optional
        Its boxes and meshes are shown, and what is near of its walls and floor.
    """
    radii = joint_radii(robot.tree, robot.tool)
    first = next(iter(motions.values()))
    return {
        "joints": [
            {
                "label": f"J{number}",
                "name": body.name,
                "parent": body.parent,
                "prismatic": body.prismatic,
                "axis": _round_nested(body.axis),
                "rotation": _round_nested(body.rotation),
                "translation": _round_nested(body.translation),
                "radius": radius,
            }
            for number, (body, radius) in enumerate(zip(robot.tree.bodies, radii, strict=True), 1)
        ],
        "tool": {"joint": robot.tool.joint, "offset": _round_nested(robot.tool.offset)},
        "shapes": _arm_shapes(robot),
        "around": _cell_shapes(robot, cell),
        "motions": [_motion_data(name, poses) for name, poses in motions.items()],
        "parts": list(first.bend),
        "part": part if part in first.bend else next(iter(first.bend), ""),
        "factor": factor,
    }


def scene_json(document: Mapping[str, Any]) -> str:
    """Text that may stand inside a script element of a page."""
    text = json.dumps(plain(document), separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c")


def _motion_data(name: str, poses: Poses) -> dict[str, Any]:
    return {
        "name": name,
        "time": _round_nested(poses.time),
        "position": _round_nested(poses.position),
        "bend": {part: _round_nested(values, 9) for part, values in poses.bend.items()},
        "share": {part: _round_nested(values, 4) for part, values in poses.share.items()},
        "deflection": {part: _round_nested(values, 9) for part, values in poses.deflection.items()},
    }


def _arm_shapes(robot: Robot) -> list[dict[str, Any]]:
    """Shapes of the URDF; capsules for moving links that it does not show."""
    placed = [each for each in robot.joint_shapes("visual") if each.shape.known]
    placed = placed or [each for each in robot.joint_shapes("collision") if each.shape.known]
    meshes = max(sum(each.shape.kind == "mesh" for each in placed), 1)
    shapes: list[dict[str, Any]] = []
    for each in placed:
        # A mesh that cannot be read leaves a capsule: a picture is no reason to lose a page.
        with suppress(InputFileError):
            shapes.append(_shape_data(each, _MAX_ARM_TRIANGLES // meshes))
    shown = {shape["joint"] for shape in shapes}
    for rod in capsules(robot.tree, robot.tool):
        # What carries shapes needs no capsule; the base is shown where the rest is not.
        if rod.joint in shown or (rod.joint == 0 and shown):
            continue
        shapes.append(
            {
                "joint": rod.joint,
                "kind": "capsule",
                "begin": _round_nested(rod.begin),
                "end": _round_nested(rod.end),
                "radius": rod.radius,
            }
        )
    return shapes


def _cell_shapes(robot: Robot, cell: Cell | None) -> list[dict[str, Any]]:
    placed = shapes_around(cell, reach(robot.tree, robot.tool))
    meshes = max(sum(each.shape.kind == "mesh" for each in placed), 1)
    found = []
    for each in placed:
        with suppress(InputFileError):
            found.append(
                _shape_data(each, _MAX_ARM_TRIANGLES // meshes) | {"name": each.shape.name}
            )
    return found


def _shape_data(placed: JointShape, triangles: int) -> dict[str, Any]:
    shape = placed.shape
    document = {
        "joint": placed.joint,
        "kind": shape.kind,
        "offset": _round_nested(placed.offset),
        "rotation": _round_nested(placed.rotation),
    }
    if shape.kind == "mesh":
        return document | compact_mesh(shape, min(triangles, 6000))
    return document | {"size": list(shape.size)}


def _round_nested(values: np.ndarray, digits: int = 6) -> list[Any]:
    """Nested lists, rounded: a page needs no more."""
    rounded: list[Any] = np.round(np.asarray(values, dtype=float), digits).tolist()
    return rounded
