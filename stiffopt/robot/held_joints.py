"""Joints of a URDF that an arm does not move: locked ones, fingers and what follows them.

The arm is the chain of joints from the base to its tip. All others are held where the robot file
says, else at zero (or the limit nearest to it), and what they carry belongs to the link before.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from stiffopt.errors import RobotError, nearest
from stiffopt.robot.rotations import about_axis, rotation_from_rpy, rpy_from_rotation
from stiffopt.units import fit_joint

_MOVING = ("revolute", "continuous", "prismatic")
# A branch of so many joints, behind an arm of so many, is a finger and no second arm.
_FINGER, _ARM = 4, 3
# What the one joint of a gripper is called.
_JAWS = ("gripper", "finger", "jaw", "knuckle", "claw")


@dataclass(frozen=True)
class HeldJoint:
    """A joint that does not move.

    Parameters
    ----------
    name : str
    value : float
        [rad] or [m]
    why : str
        "locked", "not on the way to the tool" or "follows JOINT".
    """

    name: str
    value: float
    why: str

    def __str__(self) -> str:
        return f"{self.name} at {self.value:g} ({self.why})"


class _Tree:
    """Joints of a URDF by name and by parent link."""

    def __init__(self, tree: ET.Element) -> None:
        self.joints = {joint.get("name", ""): joint for joint in tree.findall("joint")}
        self.below: dict[str, list[str]] = {}
        self.above: dict[str, str] = {}
        for name, joint in self.joints.items():
            self.below.setdefault(_link(joint, "parent"), []).append(name)
            self.above[_link(joint, "child")] = name

    def moves(self, name: str) -> bool:
        return self.joints[name].get("type") in _MOVING

    @property
    def moving(self) -> list[str]:
        return [name for name in self.joints if self.moves(name)]

    def way_to(self, link: str) -> list[str]:
        """Moving joints from the base to a link."""
        way: list[str] = []
        while link in self.above:
            name = self.above[link]
            if self.moves(name):
                way.insert(0, name)
            link = _link(self.joints[name], "parent")
        return way

    def follows(self, name: str) -> bool:
        """Whether a joint moves with another (mimic)."""
        return self.joints[name].find("mimic") is not None

    def next_moving(self, link: str) -> list[str]:
        """Moving joints that come next behind a link, over fixed ones."""
        found, waiting = [], list(reversed(self.below.get(link, [])))
        while waiting:
            name = waiting.pop()
            if self.moves(name):
                found.append(name)
            else:
                waiting += reversed(self.below.get(_link(self.joints[name], "child"), []))
        return found

    @cached_property
    def behind(self) -> dict[str, int]:
        """Joints of the branch that begins with each joint, which move on their own."""
        counts: dict[str, int] = {}
        order = [name for root in self.roots for name in self.below.get(root, [])]
        for name in order:  # grows: parents before children
            order += self.below.get(_link(self.joints[name], "child"), [])
        for name in reversed(order):
            deeper = self.below.get(_link(self.joints[name], "child"), [])
            own = self.moves(name) and not self.follows(name)
            counts[name] = own + sum(counts[each] for each in deeper)
        return counts

    @property
    def roots(self) -> list[str]:
        """Links without a joint to a parent."""
        return sorted({_link(j, "parent") for j in self.joints.values()} - set(self.above))

    def arm(self) -> list[str]:
        """Joints of the arm where no tip is named: up to where fingers branch off, else all."""
        way, ahead = self.trunk()
        fingers = len(way) >= _ARM and all(self.behind[each] <= _FINGER for each in ahead)
        if fingers or not ahead:
            return way
        return [name for name in self.moving if not self.follows(name)]

    def trunk(self) -> tuple[list[str], list[str]]:
        """Joints from the base to where the arm branches, and those that come next there.

        Branches that only follow joints of the way, such as the cylinder of a counterbalance, are
        no branches; jaws that follow another one make a gripper of both.
        """
        way: list[str] = []
        link = self.roots[0] if self.roots else ""
        while True:
            ahead = self.next_moving(link)
            own = [name for name in ahead if self.behind[name]]
            if len(own) == 1 and not (len(way) >= _ARM and self._is_jaw(own[0], ahead)):
                ahead = own
            elif len(long := [name for name in own if self.behind[name] > _FINGER]) == 1:
                ahead = long  # beside it a head, or wheels
            elif own or len(ahead) != 1:
                return way, own
            way += ahead
            link = _link(self.joints[ahead[0]], "child")

    def _is_jaw(self, name: str, ahead: list[str]) -> bool:
        """Whether a joint moves a jaw: by its name, or as others beside it follow it."""
        if self.behind[name] > _FINGER:
            return False
        named = self.behind[name] == 1 and any(word in name.lower() for word in _JAWS)
        return named or any(_leader(self.joints[each]) == name for each in ahead)

    def ends(self) -> list[str]:
        """Links at the ends of branches that are too long for fingers; none for one arm."""
        way, ahead = self.trunk()
        if len(way) >= _ARM and all(self.behind[each] <= _FINGER for each in ahead):
            return []
        return [self._end(name) for name in ahead if self.behind[name] > _ARM]

    def _end(self, name: str) -> str:
        """Last link of a branch before fingers."""
        link = _link(self.joints[name], "child")
        ahead = self.next_moving(link)
        while len(ahead) == 1:
            link = _link(self.joints[ahead[0]], "child")
            ahead = self.next_moving(link)
        return link


def hold_joints(
    tree: ET.Element,
    path: Path,
    *,
    lock: Mapping[str, float],
    tip: str | None,
    keep: Collection[str],
    followers: bool = False,
) -> tuple[HeldJoint, ...]:
    """Fix the joints of a URDF that the arm does not move; the tree is changed in place.

    Parameters
    ----------
    tree : Element
        `<robot>`, whose joints form a tree.
    path : Path
        Of the URDF, for messages.
    lock : mapping of joint name to float
        Where a joint is held [rad] or [m].
    tip : str or None
        Link at the end of the arm; None takes the arm up to where fingers branch off.
    keep : collection of str
        Joints that move also where they are not on the way to the tip.
    followers : bool
        Hold also joints of the arm that follow another one, in place of an error.

    Raises
    ------
    RobotError
        A locked joint that there is not or that does not move; one of the arm that follows another.
    """
    joints = _Tree(tree)
    moving = joints.moving
    for name in lock:
        if name not in moving:
            raise RobotError(
                f"{path}: lock names no moving joint {name!r}. {nearest(name, moving)}"
            )
    arm = joints.arm() if tip is None or tip not in joints.above else joints.way_to(tip)
    held = {}
    for name, given in lock.items():
        slides = joints.joints[name].get("type") == "prismatic"
        value = fit_joint(given, slides, "angle", f"lock.{name}")
        held[name] = HeldJoint(name, _in_range(joints, name, value), "locked")
    for name in moving:
        if name not in arm and name not in keep and name not in held:
            rest = _in_range(joints, name, None)
            held[name] = HeldJoint(name, rest, "not on the way to the tool")
    _hold_followers(joints, held, path, explicitly=set(lock), all_=followers)
    for each in held.values():
        _fix(joints.joints[each.name], each.value)
    return tuple(held.values())


def _hold_followers(
    joints: _Tree, held: dict[str, HeldJoint], path: Path, explicitly: set[str], all_: bool
) -> None:
    for name, joint in joints.joints.items():
        mimic = joint.find("mimic")
        if mimic is None or name in explicitly or not joints.moves(name):
            continue
        leader = _leader(joint)
        if leader not in joints.joints:
            raise RobotError(
                f"{path}: joint {name!r} follows {leader!r} (mimic), which there is not."
                f" {nearest(leader, joints.joints)}"
            )
        if leader == name:
            raise RobotError(
                f"{path}: joint {name!r} follows itself (mimic). Name the joint that it follows, or"
                " take the <mimic> away."
            )
        if leader in held or not joints.moves(leader):
            at = held[leader].value if leader in held else 0.0
            value = _number(mimic, "multiplier", 1.0) * at + _number(mimic, "offset", 0.0)
            held[name] = HeldJoint(name, value, f"follows {leader}")
        elif name in held or all_:
            rest = _in_range(joints, name, None)
            held[name] = HeldJoint(name, rest, f"follows {leader}, which moves")
        else:
            raise RobotError(
                f"{path}: joint {name!r} follows {leader!r} (mimic), which moves; an arm is planned"
                " with joints that move on their own. Hold one of the two in a robot file, such as"
                f" lock = {{ {name} = 0.0 }} (`stiffopt init robot {path.name}` writes one), or"
                " name a tip before it."
            )


def _leader(joint: ET.Element) -> str:
    """Name of the joint that a joint follows; "" where it follows none."""
    mimic = joint.find("mimic")
    return "" if mimic is None else mimic.get("joint", "")


def arm_ends(tree: ET.Element) -> list[str]:
    """Links at the ends of the arms of a URDF that has several; none where it is one arm."""
    return _Tree(tree).ends()


def _in_range(joints: _Tree, name: str, value: float | None) -> float:
    """Value within the limits of a joint; the nearest to zero where none is given."""
    joint = joints.joints[name]
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return value or 0.0
    low, high = (_number(limit, key, 0.0) for key in ("lower", "upper"))
    if value is None:
        return min(max(0.0, low), high) if low < high else 0.0
    if low < high and not low - 1e-9 <= value <= high + 1e-9:
        raise RobotError(
            f"lock: {name} is held at {value:g}, its limits are {low:g} to {high:g}."
            " Hold it within."
        )
    return value


def _number(element: ET.Element, key: str, default: float) -> float:
    try:
        return float(element.get(key, default))
    except ValueError:
        return default


def _fix(joint: ET.Element, value: float) -> None:
    """Turn a joint into a fixed one at a position [rad] or [m]."""
    origin, axis = joint.find("origin"), joint.find("axis")
    place = np.array(_vector(origin, "xyz", "0 0 0"))
    turn = rotation_from_rpy(_vector(origin, "rpy", "0 0 0"))
    along = np.array(_vector(axis, "xyz", "1 0 0"))
    along = along / max(float(np.linalg.norm(along)), 1e-300)
    if joint.get("type") == "prismatic":
        place = place + turn @ along * value
    else:
        turn = turn @ about_axis(along, value)
    joint.set("type", "fixed")
    for part in ("axis", "limit", "dynamics", "mimic", "origin"):
        for found in joint.findall(part):
            joint.remove(found)
    numbers = {"xyz": place, "rpy": rpy_from_rotation(turn)}
    ET.SubElement(
        joint, "origin", {k: " ".join(repr(float(x)) for x in v) for k, v in numbers.items()}
    )


def _vector(element: ET.Element | None, key: str, default: str) -> list[float]:
    text = default if element is None else element.get(key, default)
    return [float(part) for part in text.split()]


def _link(joint: ET.Element, end: str) -> str:
    found = joint.find(end)
    return "" if found is None else found.get("link", "")
