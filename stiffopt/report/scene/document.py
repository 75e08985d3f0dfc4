"""Content of a 3D scene as plain data: arm, cell, motions and parts of the deflection."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import to_json_types
from stiffopt.report.scene.poses import Poses
from stiffopt.robot.body_tree import arm_reach, joint_radii, link_capsules
from stiffopt.robot.cell import Cell
from stiffopt.robot.frames import rotation_from_rpy
from stiffopt.robot.joint_load import complete_axes
from stiffopt.robot.link_shapes import JointShape, Kind, LinkShape, mesh_triangles
from stiffopt.robot.robot import Robot

# Triangles of all meshes of an arm together, so that a page stays below 3 MB.
_MAX_ARM_TRIANGLES = 60000
# Triangles of one shape.
_MAX_TRIANGLES = 6000
# A wall is shown as a slab of this thickness [m].
_WALL_THICKNESS = 2e-3


def scene_document(
    robot: Robot,
    motions: Mapping[str, Poses],
    part: str,
    factor: float,
    cell: Cell | None = None,
) -> dict[str, Any]:
    """Return the content of a scene.

    `motions`: the motion that is shown, then the one drawn as its ghost. `part`: part of the
    deflection that is shown first. `factor`: initial magnification of the deflection. `cell`: cell
    around the arm: boxes, meshes, and walls and floor near the arm.
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
    """Return the document as JSON that is safe inside a script element."""
    text = json.dumps(
        to_json_types(document), separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
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
    """Return the shapes of the URDF, and capsules for links without one."""
    placed = [each for each in robot.joint_shapes("visual") if each.shape.known]
    placed = placed or [each for each in robot.joint_shapes("collision") if each.shape.known]
    meshes = max(sum(each.shape.kind == "mesh" for each in placed), 1)
    shapes: list[dict[str, Any]] = []
    for each in placed:
        # An unreadable mesh is replaced by a capsule: the page must not fail for a picture.
        with suppress(InputFileError):
            shapes.append(_shape_data(each, _MAX_ARM_TRIANGLES // meshes))
    shown = {shape["joint"] for shape in shapes}
    for rod in link_capsules(robot.tree, robot.tool):
        # Links with shapes need no capsule; the base has one only where no shapes exist.
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
    placed = shapes_around(cell, arm_reach(robot.tree, robot.tool))
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
        return document | compact_mesh(shape, min(triangles, _MAX_TRIANGLES))
    return document | {"size": list(shape.size)}


def _round_nested(values: np.ndarray, digits: int = 6) -> list[Any]:
    """Return nested lists of rounded values."""
    rounded: list[Any] = np.round(np.asarray(values, dtype=float), digits).tolist()
    return rounded


def compact_mesh(shape: LinkShape, most: int = _MAX_TRIANGLES) -> dict[str, Any]:
    """Return the mesh of a shape, vertices on a grid, triangles that vanish on it removed.

    `origin` [m] and `step` [m] of the grid, which is coarsened until at most `most` triangles
    remain; `vertices` and `triangles`, little-endian 16-bit numbers in base 64.
    """
    vertices, corners = mesh_triangles(shape)
    low = vertices.min(axis=0)
    longest = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    cells = 1024  # along the longest edge, to begin with
    while True:
        step = longest / cells
        cell = np.round((vertices - low) / step).astype(int)
        unique, number = np.unique(cell, axis=0, return_inverse=True)
        faces = number.reshape(-1)[corners]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
        if (len(faces) <= most and len(unique) < 2**16) or cells <= 8:
            break
        cells = int(cells / 1.5)
    used, compact = np.unique(faces, return_inverse=True)
    return {
        "origin": low.tolist(),
        "step": step,
        "vertices": _encode_uint16(unique[used]),
        "triangles": _encode_uint16(compact.reshape(-1)),
    }


def _encode_uint16(numbers: np.ndarray) -> str:
    return base64.b64encode(numbers.astype("<u2").tobytes()).decode()


def shapes_around(cell: Cell | None, reach: float) -> list[JointShape]:
    """Return boxes, meshes, and the near part of walls and floor, in the base frame.

    `reach`: reach of the arm [m], which bounds the part of a wall that is shown.
    """
    if cell is None:
        return []
    found = [
        _shape_at(box.name, "box", box.size, np.array(box.position), rotation_from_rpy(box.rpy))
        for box in cell.box
    ]
    for mesh in cell.mesh:
        at, turn = np.array(mesh.position), rotation_from_rpy(mesh.rpy)
        scale = (mesh.scale,) * 3
        found.append(_shape_at(mesh.name, "mesh", scale, at, turn, Path(mesh.file)))
    walls = [(plane.name, np.array(plane.point), np.array(plane.normal)) for plane in cell.plane]
    if cell.floor is not None:
        walls.append(("floor", np.array([0.0, 0.0, cell.floor]), np.array([0.0, 0.0, 1.0])))
    side = 2.4 * reach
    for name, point, normal in walls:
        out = normal / np.linalg.norm(normal)
        # Centred at the base and entirely behind the face.
        middle = out * (out @ point - 0.5 * _WALL_THICKNESS)
        found.append(
            _shape_at(name, "box", (side, side, _WALL_THICKNESS), middle, complete_axes(out))
        )
    return found


def _shape_at(
    name: str,
    kind: Kind,
    size: tuple[float, ...],
    offset: np.ndarray,
    rotation: np.ndarray,
    file: Path | None = None,
) -> JointShape:
    shape = LinkShape(
        link=name,
        purpose="visual",
        kind=kind,
        size=tuple(size),
        offset=offset,
        rotation=rotation,
        name=name,
        file=file,
    )
    return JointShape(shape, 0, offset, rotation)


def edges_around(cell: Cell | None) -> np.ndarray:
    """Return the edges of all boxes (k, 2, 3), base frame [m]."""
    edges = []
    for box in () if cell is None else cell.box:
        turn, half = rotation_from_rpy(box.rpy), 0.5 * np.array(box.size)
        for axis in range(3):
            for signs in product((-1.0, 1.0), repeat=2):
                begin = np.insert(signs, axis, -1.0)
                end = np.insert(signs, axis, 1.0)
                edges.append(
                    [np.array(box.position) + turn @ (half * each) for each in (begin, end)]
                )
    return np.array(edges).reshape(-1, 2, 3)
