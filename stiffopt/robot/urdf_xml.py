"""Links and joints of a URDF or MJCF as one tree of XML elements, and the meshes of a URDF."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote, urlparse

from stiffopt.errors import InputFileError, RobotError, nearest, shortened
from stiffopt.robot.mjcf import MJCF_ROOT, read_mjcf
from stiffopt.robot.xml_files import parse_xml

# Number of links or joints; the loader's time grows with its square.
_MAX_NAMED_ELEMENTS = 1000
# Elements of xacro that only define something and can be ignored.
_XACRO_DEFINITIONS = ("property", "arg", "macro")
# Other robot formats by the root of their XML.
_OTHER_FORMATS = {"sdf": "an SDF (a model of Gazebo)"}
# Mechanical parts of links and joints; shapes and colours are ignored.
_MECHANICAL_PARTS = {
    "link": ("inertial",),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
}


def read_urdf_tree(path: str | os.PathLike[str]) -> ET.Element:
    """Read the mechanics of a URDF or MJCF: `<robot>` with links and joints that form one tree.

    Raises `InputFileError` or `RobotError`: neither a URDF nor an MJCF; a missing or repeated name;
    a joint between unknown links; a link with two parents, a loop, more than one root.
    """
    path = Path(path)
    found = parse_xml(path)
    if found.tag == MJCF_ROOT:
        # Rotations need pinocchio, which a URDF read for its files alone does without.
        from stiffopt.robot.mjcf_tree import build_tree

        tree = build_tree(read_mjcf(path))
    else:
        tree = _read_urdf_mechanics(found, path)
    for kind in _MECHANICAL_PARTS:
        _check_names(tree, kind, path)
    _check_tree(tree, path)
    return tree


def _read_urdf_mechanics(found: ET.Element, path: Path) -> ET.Element:
    """Copy links and joints of a URDF without shapes and extensions."""
    if found.tag != "robot":
        tag = shortened(found.tag)[1:-1]
        if tag in _OTHER_FORMATS:
            raise InputFileError(path, "", unsupported_format(_OTHER_FORMATS[tag]))
        raise InputFileError(path, "", f"is not a URDF: the root is <{tag}>, not <robot>.")
    tree = ET.Element("robot", name=found.get("name", "robot"))
    for kind, kept in _MECHANICAL_PARTS.items():
        for each in found.findall(kind):
            bare = ET.SubElement(tree, kind, each.attrib)
            for name in kept:
                part = each.find(name)
                if part is not None:
                    _copy_part(part, bare)
    _check_expanded(found, tree, path)
    return tree


def unsupported_format(kind: str) -> str:
    """Message on a robot in an unsupported format, with the remedy."""
    return (
        f"is {kind}; URDF and MJCF are read. Take the URDF that came with the arm or that its CAD"
        " exports, or expand its xacro: `xacro arm.urdf.xacro > arm.urdf`."
    )


def _check_expanded(found: ET.Element, tree: ET.Element, path: Path) -> None:
    """Raise `InputFileError` for a file with unexpanded xacro."""
    left = [v for each in tree.iter() for v in each.attrib.values() if "${" in v or "$(" in v]
    called = [name for each in found for name in _xacro_calls(each)]
    if left or called:
        shown = shortened(left[0]) if left else f"<xacro:{called[0]}>"
        raise InputFileError(
            path,
            "",
            f"holds xacro that is not expanded, such as {shown}. Expand it first:"
            f" `xacro {path.name} > robot.urdf`.",
        )


def _xacro_calls(element: ET.Element) -> Iterator[str]:
    """Names of the xacro macros called by an element and its parts."""
    if not isinstance(element.tag, str):
        return
    space, _, name = element.tag.rpartition(":")
    if "xacro" in space:
        if name not in _XACRO_DEFINITIONS:
            yield name
        return
    for inner in element:
        yield from _xacro_calls(inner)


def _copy_part(part: ET.Element, bare: ET.Element) -> None:
    """Copy a part with its children."""
    copied = ET.SubElement(bare, part.tag, part.attrib)
    for inner in part:
        if isinstance(inner.tag, str):
            ET.SubElement(copied, inner.tag, inner.attrib)


def _check_names(tree: ET.Element, kind: str, path: Path) -> None:
    names = Counter(each.get("name", "") for each in tree.findall(kind))
    if names.total() > _MAX_NAMED_ELEMENTS:
        raise RobotError(
            f"{path}: has {names.total()} {kind}s; at most {_MAX_NAMED_ELEMENTS} are read."
        )
    for name, count in names.items():
        if not name:
            raise RobotError(f"{path}: a {kind} has no name. Give each a name of its own.")
        if count > 1:
            raise RobotError(
                f"{path}: {count} {kind}s are named {shortened(name)}. Give each a name of its own."
            )


def _check_tree(tree: ET.Element, path: Path) -> None:
    """Raise `RobotError` unless the joints connect all links as one tree."""
    links = [link.get("name", "") for link in tree.findall("link")]
    above: dict[str, tuple[str, str]] = {}
    for joint in tree.findall("joint"):
        name = joint.get("name", "")
        parent, child = (_joint_link(joint, end, links, path) for end in ("parent", "child"))
        if child in above:
            raise RobotError(
                f"{path}: link {child!r} is the child of two joints, {above[child][1]!r} and "
                f"{name!r}. An arm is a tree: keep one."
            )
        above[child] = (parent, name)
    roots = [link for link in links if link not in above]
    reached, waiting = set(), roots[:1]
    below: dict[str, list[str]] = {}
    for child, (parent, _) in above.items():
        below.setdefault(parent, []).append(child)
    while waiting:
        link = waiting.pop()
        reached.add(link)
        waiting += below.get(link, [])
    if len(roots) > 1:
        raise RobotError(
            f"{path}: the links {', '.join(map(repr, roots[:5]))} have no joint to a parent. An "
            "arm has one such link, its base: join the others to it, or remove them."
        )
    lost = [link for link in links if link not in reached]
    if lost:
        joints = [above[link][1] for link in lost if link in above]
        raise RobotError(
            f"{path}: the joints {', '.join(map(repr, joints[:5]))} form a loop. An arm is a tree "
            "that begins at its base: correct a parent."
        )


def _joint_link(joint: ET.Element, end: str, links: list[str], path: Path) -> str:
    found = joint.find(end)
    link = "" if found is None else found.get("link", "")
    if link not in links:
        raise RobotError(
            f"{path}: joint {joint.get('name')!r} names the {end} {shortened(link)}, which is no "
            f"link. {nearest(link, links)}"
        )
    return link


def mesh_files(urdf: Path) -> list[Path]:
    """Find the mesh files that a URDF names; none for a file that is no XML."""
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
    """Find the file of a mesh that a URDF names; None where it does not exist.

    Paths are relative to the URDF's folder. The folder NAME of package://NAME/REST is searched for
    among the parent folders of the URDF and their children, then in ROS_PACKAGE_PATH and
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
