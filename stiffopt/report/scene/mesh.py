"""Meshes small enough for a page: vertices on a grid, triangles that vanish on it left out."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from stiffopt.robot.link_shapes import LinkShape, triangles

# Triangles of one shape, and cells of the grid along the longest edge to begin with.
_MAX_TRIANGLES = 6000
_INITIAL_GRID_CELLS = 1024


def compact_mesh(shape: LinkShape, most: int = _MAX_TRIANGLES) -> dict[str, Any]:
    """Mesh of a shape as the scene reads it.

    Parameters
    ----------
    shape : LinkShape
        A mesh that was found.
    most : int
        Triangles; a finer mesh is put on a coarser and coarser grid until it fits.

    Returns
    -------
    dict
        `origin` [m] and `step` [m] of the grid; `vertices` and `triangles`, little-endian
        16-bit numbers in base 64.
    """
    vertices, corners = triangles(shape)
    low = vertices.min(axis=0)
    longest = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    cells = _INITIAL_GRID_CELLS
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
