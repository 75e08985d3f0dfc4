"""Visual and collision shapes of links in a URDF."""

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

from stiffopt.errors import RobotError, shortened
from stiffopt.files import read_bytes
from stiffopt.robot.frames import rotation_from_rpy
from stiffopt.robot.meshes import MAX_MESH_BYTES, load_mesh_file
from stiffopt.robot.urdf import urdf_numbers
from stiffopt.robot.urdf_xml import find_mesh
from stiffopt.robot.xml_files import parse_xml

Purpose = Literal["visual", "collision"]
Kind = Literal["box", "cylinder", "sphere", "mesh"]

_SIZE_ATTRIBUTES: dict[str, tuple[str, ...]] = {
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkShape:
    """One shape of one link.

    Parameters
    ----------
    purpose : "visual" or "collision"
    kind : "box", "cylinder", "sphere" or "mesh"
    size : tuple of float
        Edges of a box; radius and length of a cylinder (along z); radius of a sphere [m]; scale of
        a mesh along its axes.
    offset : array (3,)
        Origin in the link's frame [m].
    rotation : array (3, 3)
        Axes as columns in the link's frame.
    digest : str
        SHA-256 of the mesh file; "" where it was not found.
    name : str
        Name of the mesh in the URDF.
    file : Path or None
        Path of the mesh file.
    """

    link: str
    purpose: Purpose
    kind: Kind
    size: tuple[float, ...]
    offset: np.ndarray
    rotation: np.ndarray
    digest: str = ""
    name: str = ""
    # Compared by content (digest), not by path.
    file: Path | None = field(default=None, compare=False)

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

    Raises
    ------
    RobotError
        A size that is no finite number, or below 0.
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
    """Vertices (V, 3) [m] and triangles (T, 3) of a scaled mesh.

    Raises
    ------
    InputFileError
        The file is no mesh.
    """
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
