"""The XML of a URDF before any library sees it: its links and joints are one tree, and small."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from stiffopt.errors import InputFileError, RobotError, nearest, shortened
from stiffopt.robot.xml_files import parse_xml

# Of links or joints; the loader's time grows with their square.
_MOST = 1000
# Elements of xacro that only define something: without them the arm is the same.
_DEFINING = ("property", "arg", "macro")
# Robots in other formats, by the root of their XML.
_OTHERS = {"mujoco": "an MJCF (a model of MuJoCo)", "sdf": "an SDF (a model of Gazebo)"}
# What of a link and of a joint is mechanics; shapes and colours are left out.
_KEPT = {
    "link": ("inertial",),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
}


def read_tree(path: str | os.PathLike[str]) -> ET.Element:
    """Mechanics of a URDF: `<robot>` with its links and joints, which make up one tree.

    Raises
    ------
    InputFileError, RobotError
        No URDF; a name that is missing or given twice; a joint between links that are not there; a
        link with two parents, a loop, more than one root.
    """
    path = Path(path)
    found = parse_xml(path)
    if found.tag != "robot":
        tag = shortened(found.tag)[1:-1]
        if tag in _OTHERS:
            raise InputFileError(path, "", unread_model(_OTHERS[tag]))
        raise InputFileError(path, "", f"is not a URDF: the root is <{tag}>, not <robot>.")
    tree = ET.Element("robot", name=found.get("name", "robot"))
    for kind, kept in _KEPT.items():
        for each in found.findall(kind):
            bare = ET.SubElement(tree, kind, each.attrib)
            for name in kept:
                part = each.find(name)
                if part is not None:
                    _copy(part, bare)
        _check_names(tree, kind, path)
    _check_expanded(found, tree, path)
    _check_joined(tree, path)
    return tree


def unread_model(kind: str) -> str:
    """What to do with a robot in a format that is not read."""
    return (
        f"is {kind}; only URDF is read. Take the URDF that came with the arm or that its CAD"
        " exports, or expand its xacro: `xacro arm.urdf.xacro > arm.urdf`."
    )


def _check_expanded(found: ET.Element, tree: ET.Element, path: Path) -> None:
    """Raise `InputFileError` for a file that xacro has not expanded."""
    left = [v for each in tree.iter() for v in each.attrib.values() if "${" in v or "$(" in v]
    called = [name for each in found for name in _macros(each)]
    if left or called:
        shown = shortened(left[0]) if left else f"<xacro:{called[0]}>"
        raise InputFileError(
            path,
            "",
            f"holds xacro that is not expanded, such as {shown}. Expand it first:"
            f" `xacro {path.name} > robot.urdf`.",
        )


def _macros(element: ET.Element) -> Iterator[str]:
    """Names of what xacro would put in place of an element and its parts."""
    if not isinstance(element.tag, str):
        return
    space, _, name = element.tag.rpartition("}")
    if "xacro" in space:
        if name not in _DEFINING:
            yield name
        return
    for inner in element:
        yield from _macros(inner)


def _copy(part: ET.Element, bare: ET.Element) -> None:
    """Add a part with its own parts, which have none again."""
    copied = ET.SubElement(bare, part.tag, part.attrib)
    for inner in part:
        if isinstance(inner.tag, str):
            ET.SubElement(copied, inner.tag, inner.attrib)


def _check_names(tree: ET.Element, kind: str, path: Path) -> None:
    names = Counter(each.get("name", "") for each in tree.findall(kind))
    if names.total() > _MOST:
        raise RobotError(f"{path}: has {names.total()} {kind}s; at most {_MOST} are read.")
    for name, count in names.items():
        if not name:
            raise RobotError(f"{path}: a {kind} has no name. Give each a name of its own.")
        if count > 1:
            raise RobotError(
                f"{path}: {count} {kind}s are named {shortened(name)}. Give each a name of its own."
            )


def _check_joined(tree: ET.Element, path: Path) -> None:
    """Raise `RobotError` unless joints lead from one link to every other, to each on one way."""
    links = [link.get("name", "") for link in tree.findall("link")]
    above: dict[str, tuple[str, str]] = {}
    for joint in tree.findall("joint"):
        name = joint.get("name", "")
        parent, child = (_end(joint, end, links, path) for end in ("parent", "child"))
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


def _end(joint: ET.Element, end: str, links: list[str], path: Path) -> str:
    found = joint.find(end)
    link = "" if found is None else found.get("link", "")
    if link not in links:
        raise RobotError(
            f"{path}: joint {joint.get('name')!r} names the {end} {shortened(link)}, which is no "
            f"link. {nearest(link, links)}"
        )
    return link
