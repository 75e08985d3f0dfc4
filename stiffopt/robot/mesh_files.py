"""Files of meshes that a URDF names."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote, urlparse

from stiffopt.errors import InputFileError
from stiffopt.robot.xml_files import parse_xml


def mesh_files(urdf: Path) -> list[Path]:
    """Meshes that a URDF names, as far as they are found; none of a file that is no XML."""
    try:
        names = {mesh.get("filename", "") for mesh in parse_xml(urdf).iter("mesh")}
    except InputFileError:
        return []
    found = []
    for name in sorted(names):
        with suppress(OSError, ValueError):
            found.append(find_mesh(name, urdf))
    return [file for file in found if file is not None]


def find_mesh(name: str, urdf: Path) -> Path | None:
    """File of a mesh that a URDF names; None where there is none.

    A path counts from the URDF's folder. Of package://NAME/REST, the folder NAME is sought among
    the URDF's own folders upwards and what lies in them, then in ROS_PACKAGE_PATH and
    AMENT_PREFIX_PATH.
    """
    url = urlparse(name)
    folder = urdf.resolve().parent
    if url.scheme != "package":
        path = Path(unquote(url.path)) if url.scheme == "file" else folder / name
        return path if path.is_file() else None
    package, rest = url.netloc, unquote(url.path).lstrip("/")
    roots = [place for up in (folder, *folder.parents) for place in (up, up / package)]
    roots = [root for root in roots if root.name == package]
    for variable, share in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for root in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            roots += [Path(root) / share / package, Path(root)]
    return next((root / rest for root in roots if (root / rest).is_file()), None)
