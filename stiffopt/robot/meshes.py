"""Loading of meshes, with checks of inputs on which coal would crash."""

from __future__ import annotations

import os
from pathlib import Path

import coal
import numpy as np

from stiffopt.errors import InputFileError, shortened
from stiffopt.files import check_file

# Size of a mesh file [bytes]; a link of a million triangles has 50 MB.
MAX_MESH_BYTES = 2**26
# Longest edge of the bounding box of a mesh [m]: beyond any cell, and below any part.
MAX_EXTENT, MIN_EXTENT = 1e4, 1e-6
# Smallest over largest extent along the principal axes; Qhull crashes on plates without thickness,
# for which single precision leaves ratios of 1e-8.
MIN_THICKNESS = 1e-5


def load_mesh_file(
    path: str | os.PathLike[str], scale: np.ndarray, *, boxes: bool = False
) -> coal.BVHModelBase:
    """Load a mesh (STL, OBJ, DAE and others) scaled along its axes (3,).

    Parameters
    ----------
    scale : array (3,)
    boxes : bool
        Build the bounding-volume tree for distances to the mesh itself.

    Raises
    ------
    InputFileError
        No mesh, a size that is not plausible, or a scale of zero.
    """
    path = Path(path)
    check_file(path, MAX_MESH_BYTES)
    sizes = np.abs(scale)
    if not np.all(np.isfinite(sizes)) or np.any(sizes == 0.0):
        raise InputFileError(
            path, "", f"has the scale {np.array(scale).tolist()}: give finite factors other than 0."
        )
    # Axis-aligned trees accept coordinates that are not finite; others crash.
    mesh = _load_mesh(path, scale, coal.NODE_TYPE.BV_AABB)
    vertices = np.atleast_2d(np.array(mesh.vertices(), dtype=float))
    extent = float(np.ptp(vertices, axis=0).max()) if np.isfinite(vertices).all() else np.nan
    if mesh.num_tris == 0 or not MIN_EXTENT <= extent <= MAX_EXTENT:
        raise InputFileError(
            path, "", f"cannot be used as a mesh: {mesh.num_tris} triangles, {extent:.3g} m from"
            f" end to end; allowed are {MIN_EXTENT:g} to {MAX_EXTENT:g} m. Check its scale."
        )  # fmt: skip
    return _load_mesh(path, scale, coal.NODE_TYPE.BV_OBBRSS) if boxes else mesh


def convex_hull(mesh: coal.BVHModelBase, path: Path | None) -> coal.ConvexBase:
    """Convex hull of a mesh.

    Raises
    ------
    InputFileError
        A mesh without volume.
    """
    vertices = np.array(mesh.vertices(), dtype=float).reshape(-1, 3)
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if len(vertices) < 4 or not spread[2] > MIN_THICKNESS * spread[0]:
        raise InputFileError(
            path, "", "is flat, and a body that collides needs a volume. Give the link a box."
        )
    # Default options of Qhull; vertices are kept.
    mesh.buildConvexHull(True, "Qt")
    return mesh.convex


def _load_mesh(path: Path, scale: np.ndarray, tree: coal.NODE_TYPE) -> coal.BVHModelBase:
    try:
        return coal.MeshLoader(tree).load(str(path), np.asarray(scale, dtype=float))
    except (ValueError, RuntimeError) as error:
        raise InputFileError(path, "", f"cannot be read as a mesh: {shortened(error)}.") from error
