"""Boxes of the cell around an arm, as the still and the browser draw them."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.robot.rotations import rotation_from_rpy

if TYPE_CHECKING:
    from stiffopt.robot.cell import Cell


def boxes_around(cell: Cell | None) -> list[dict[str, Any]]:
    """Shapes in the base frame, in the form of those of links."""
    return [
        {
            "kind": "box",
            "size": list(box.size),
            "offset": list(box.position),
            "rotation": rotation_from_rpy(box.rpy).tolist(),
        }
        for box in (() if cell is None else cell.box)
    ]


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
