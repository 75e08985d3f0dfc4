"""What stands around an arm, as the still, the page and the live view draw it."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.robot.link_shapes import JointShape, Kind, LinkShape
from stiffopt.robot.rotations import rotation_from_rpy

if TYPE_CHECKING:
    from stiffopt.robot.cell import Cell

# A wall is shown as a slab so thick [m], so many reaches of the arm to each side.
_WALL_THICKNESS, _WALL_HALF_WIDTH_REACHES = 2e-3, 1.2


def shapes_around(cell: Cell | None, reach: float) -> list[JointShape]:
    """Boxes, meshes, and the near part of walls and floor, in the base frame.

    Parameters
    ----------
    cell : Cell or None
    reach : float
        Of the arm [m]: what lies farther out of a wall is not shown.
    """
    if cell is None:
        return []
    found = [
        _placed_shape(box.name, "box", box.size, np.array(box.position), rotation_from_rpy(box.rpy))
        for box in cell.box
    ]
    for mesh in cell.mesh:
        at, turn = np.array(mesh.position), rotation_from_rpy(mesh.rpy)
        scale = (mesh.scale,) * 3
        found.append(_placed_shape(mesh.name, "mesh", scale, at, turn, Path(mesh.file)))
    walls = [(plane.name, np.array(plane.point), np.array(plane.normal)) for plane in cell.plane]
    if cell.floor is not None:
        walls.append(("floor", np.array([0.0, 0.0, cell.floor]), np.array([0.0, 0.0, 1.0])))
    side = 2.0 * _WALL_HALF_WIDTH_REACHES * reach
    for name, point, normal in walls:
        out = normal / np.linalg.norm(normal)
        # Seen from the base, and all of it behind the face.
        middle = out * (out @ point - 0.5 * _WALL_THICKNESS)
        found.append(
            _placed_shape(name, "box", (side, side, _WALL_THICKNESS), middle, _frame_along(out))
        )
    return found


def _placed_shape(
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


def _frame_along(axis: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose third column is a unit vector."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(other, axis)
    first = first / np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def edges_around(cell: Cell | None) -> np.ndarray:
    """Edges of all boxes (k, 2, 3), base frame [m]."""
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
