"""Visual and collision shapes of links in a URDF, and loading of their meshes."""

from __future__ import annotations

import hashlib
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import coal
import numpy as np
import pinocchio as pin

from stiffopt.errors import InputFileError, RobotError, shortened
from stiffopt.files import check_file, read_bytes
from stiffopt.robot.frames import rotation_from_rpy
from stiffopt.robot.urdf import urdf_numbers
from stiffopt.robot.urdf_xml import find_mesh
from stiffopt.robot.xml_files import parse_xml

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

    `scale` (3,). `boxes`: build the bounding-volume tree for distances to the mesh itself. Raises
    `InputFileError`: no mesh, a size that is not plausible, or a scale of zero.
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

    Raises `InputFileError`: a mesh without volume.
    """
    vertices = np.array(mesh.vertices(), dtype=float).reshape(-1, 3)
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if len(vertices) < 4 or not spread[2] > MIN_THICKNESS * spread[0]:
        raise InputFileError(
            path, "", "is flat, and a body that collides needs a volume. Give the link a box."
        )
    try:
        # Default options of Qhull; vertices are kept.
        mesh.buildConvexHull(True, "Qt")
    except RuntimeError:
        # Large flat faces are triangulated from one vertex, to which coal allows 255 neighbours;
        # moved by rounding, their points have no common plane.
        mesh.buildConvexHull(True, "QJ")
    return mesh.convex


def _load_mesh(path: Path, scale: np.ndarray, tree: coal.NODE_TYPE) -> coal.BVHModelBase:
    try:
        return coal.MeshLoader(tree).load(str(path), np.asarray(scale, dtype=float))
    except (ValueError, RuntimeError) as error:
        raise InputFileError(path, "", f"cannot be read as a mesh: {shortened(error)}.") from error


Purpose = Literal["visual", "collision"]
Kind = Literal["box", "cylinder", "sphere", "mesh"]

_SIZE_ATTRIBUTES: dict[str, tuple[str, ...]] = {
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkShape:
    """One shape of one link."""

    link: str
    purpose: Purpose  # "visual" or "collision"
    kind: Kind  # "box", "cylinder", "sphere" or "mesh"
    # Edges of a box; radius and length of a cylinder (along z); radius of a sphere [m]; scale of a
    # mesh along its axes.
    size: tuple[float, ...]
    offset: np.ndarray  # (3,) origin in the link's frame [m]
    rotation: np.ndarray  # (3, 3) axes as columns in the link's frame
    digest: str = ""  # SHA-256 of the mesh file; "" where it was not found
    name: str = ""  # name of the mesh in the URDF
    # Compared by content (digest), not by path.
    file: Path | None = field(default=None, compare=False)  # path of the mesh file

    @property
    def known(self) -> bool:
        """Return whether the geometry is known: False for a mesh that was not found."""
        return self.kind != "mesh" or self.file is not None


@dataclass(frozen=True, eq=False)
class JointShape:
    """A shape in the frame of the joint that carries its link; joint 0 is the base."""

    shape: LinkShape
    joint: int
    offset: np.ndarray
    rotation: np.ndarray


def read_link_shapes(path: str | os.PathLike[str]) -> tuple[LinkShape, ...]:
    """Read all shapes of a URDF that `load_urdf` has checked.

    Raises `RobotError`: a size that is no finite number, or below 0.
    """
    urdf = Path(path)
    found = []
    for link in parse_xml(urdf).findall("link"):
        for purpose in ("visual", "collision"):
            for section in link.findall(purpose):
                shape = _read_shape(section, link.get("name", ""), purpose, urdf)
                if shape is not None:
                    found.append(shape)
    return tuple(found)


def joint_shapes(
    model: pin.Model, shapes: Iterable[LinkShape], purpose: Purpose
) -> list[JointShape]:
    """Shapes of one purpose in the frames of the model's joints."""
    placed = []
    for shape in shapes:
        if shape.purpose != purpose or not model.existBodyName(shape.link):
            continue
        frame = model.frames[model.getFrameId(shape.link, pin.FrameType.BODY)]
        at = frame.placement * pin.SE3(shape.rotation, shape.offset)
        placed.append(
            JointShape(shape, int(frame.parentJoint), at.translation.copy(), at.rotation.copy())
        )
    return placed


def mesh_triangles(shape: LinkShape) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) [m] and triangles (T, 3) of a scaled mesh; or raise `InputFileError`."""
    model = load_mesh(shape)
    corners = [[model.tri_indices(i)[k] for k in range(3)] for i in range(model.num_tris)]
    return np.array(model.vertices(), dtype=float), np.array(corners, dtype=int)


def load_mesh(shape: LinkShape) -> coal.BVHModelBase:
    """Load a scaled mesh (STL, OBJ, DAE and others) with coal."""
    assert shape.file is not None
    return load_mesh_file(shape.file, np.array(shape.size))


def _read_shape(section: ET.Element, link: str, purpose: Purpose, urdf: Path) -> LinkShape | None:
    """Read one visual or collision section; None for no shape or one without extent."""
    geometry = section.find("geometry")
    if geometry is None or len(geometry) == 0:
        return None
    place = f"{urdf}: link {link!r}, {purpose}"
    origin = section.find("origin")
    given = {} if origin is None else origin.attrib
    offset = urdf_numbers(given.get("xyz", "0 0 0"), 3, f"{place} origin xyz")
    angles = urdf_numbers(given.get("rpy", "0 0 0"), 3, f"{place} origin rpy")
    own = geometry[0]
    name, file, digest = "", None, ""
    if own.tag == "mesh":
        size = urdf_numbers(own.get("scale", "1 1 1"), 3, f"{place} mesh scale")
        name = own.get("filename", "")
        with suppress(OSError, ValueError):  # names that no file can have
            file = find_mesh(name, urdf)
        if file is not None:
            digest = hashlib.sha256(read_bytes(file, MAX_MESH_BYTES)).hexdigest()
    elif own.tag == "box":
        size = _read_extents(own.get("size", ""), 3, f"{place} box size")
    elif own.tag in _SIZE_ATTRIBUTES:
        keys = _SIZE_ATTRIBUTES[own.tag]
        size = [_read_extents(own.get(key, ""), 1, f"{place} {own.tag} {key}")[0] for key in keys]
    else:
        return None
    if own.tag != "mesh" and min(size) == 0.0:
        return None
    return LinkShape(
        link=link,
        purpose=purpose,
        kind=own.tag,  # type: ignore[arg-type]
        size=tuple(size),
        offset=np.array(offset),
        rotation=rotation_from_rpy(np.array(angles)),
        digest=digest,
        name=name,
        file=file,
    )


def _read_extents(text: str, count: int, place: str) -> list[float]:
    values = urdf_numbers(text, count, place)
    if min(values) < 0.0:
        raise RobotError(
            f"{place}: got {shortened(text)}, allowed is 0 or above. Correct the file."
        )
    return values
