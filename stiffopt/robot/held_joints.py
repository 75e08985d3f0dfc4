"""Joints of a URDF that are no joints of the arm: locked ones, fingers and their followers.

The arm is the chain of joints from the base to its tip. All others are fixed at the position of the
robot file, else at zero (or the limit nearest to it), and their links merge with the link before.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.errors import RobotError, nearest
from stiffopt.robot.frames import rotation_about_axis, rotation_from_rpy, rpy_from_rotation
from stiffopt.robot.joint_tree import PLANNED_KINDS, JointTree, mimicked_joint
from stiffopt.robot.xml_files import numbers_text
from stiffopt.units import fit_joint


@dataclass(frozen=True)
class HeldJoint:
    """A joint that is held fixed."""

    name: str
    value: float  # [rad] or [m]
    why: str  # "locked", "not on the way to the tool" or "follows JOINT"


def fix_free_joints(
    tree: ET.Element, *, lock: Collection[str], tip: str | None, all_: bool
) -> tuple[HeldJoint, ...]:
    """Fix joints of several degrees of freedom where they are, in place.

    Those that are locked, and those of objects that are no part of the arm; free bases and ball
    joints of the arm as well if `all_`.
    """
    joints = JointTree(tree)
    leading = set(joints.joints_to(tip)) if tip in joints.above else None
    held = []
    for name, joint in joints.joints.items():
        if joint.get("type") in (*PLANNED_KINDS, "fixed"):
            continue
        of_arm = joints.behind[name] > 0 if leading is None else name in leading
        if name in lock:
            why = "locked"
        elif not of_arm:
            why = "not on the way to the tool"
        elif all_:
            why = f"{joint.get('type')} in the model"
        else:
            continue
        held.append(HeldJoint(name, 0.0, why))
        _fix_joint(joint, 0.0)
    return tuple(held)


def hold_joints(
    tree: ET.Element,
    path: Path,
    *,
    lock: Mapping[str, float],
    tip: str | None,
    keep: Collection[str],
    followers: bool = False,
) -> tuple[HeldJoint, ...]:
    """Fix the joints of a URDF that are no joints of the arm, in place.

    `lock` gives positions of locked joints [rad] or [m]; `tip` is the link at the end of the arm
    (None: up to the branch of the fingers); joints in `keep` stay although they do not lead there.
    Joints of the arm that follow another one are fixed with `followers`, else an error, as are a
    locked joint that does not exist or is fixed, and several chains of which none is named.
    """
    joints = JointTree(tree)
    moving = joints.moving
    for name in lock:
        if name not in moving:
            raise RobotError(
                f"{path}: lock names no moving joint {name!r}. {nearest(name, moving)}"
            )
    arm = joints.path_to(tip) if tip in joints.above else _find_arm(joints, path, tip, lock, keep)
    held = {}
    for name, given in lock.items():
        slides = joints.joints[name].get("type") == "prismatic"
        value = fit_joint(given, slides, "angle", f"lock.{name}")
        held[name] = HeldJoint(name, _value_within_limits(joints, name, value), "locked")
    for name in moving:
        if name not in arm and name not in keep and name not in held:
            rest = _value_within_limits(joints, name, None)
            held[name] = HeldJoint(name, rest, "not on the way to the tool")
    _hold_followers(joints, held, path, explicitly=set(lock), all_=followers)
    for each in held.values():
        _fix_joint(joints.joints[each.name], each.value)
    return tuple(held.values())


def _find_arm(
    joints: JointTree,
    path: Path,
    tip: str | None,
    lock: Collection[str],
    keep: Collection[str],
) -> list[str]:
    """Joints of the arm where no moved link is named as its tip."""
    arm = joints.arm(keep)
    if arm is None and lock:
        arm = JointTree(joints.tree, still=lock).arm(keep)
    if arm is not None:
        return arm
    if tip is not None and tip not in joints.links:
        raise RobotError(f"{path}: there is no link {tip!r}. {nearest(tip, joints.links)}")
    raise RobotError(f"{path}: {joints.describe_branches()}")


def _hold_followers(
    joints: JointTree, held: dict[str, HeldJoint], path: Path, explicitly: set[str], all_: bool
) -> None:
    for name, joint in joints.joints.items():
        mimic = joint.find("mimic")
        if mimic is None or name in explicitly or not joints.moves(name):
            continue
        first = mimicked_joint(joint)
        if first not in joints.joints:
            raise RobotError(
                f"{path}: joint {name!r} follows {first!r} (mimic), which there is not."
                f" {nearest(first, joints.joints)}"
            )
        if first == name:
            raise RobotError(
                f"{path}: joint {name!r} follows itself (mimic). Name the joint that it follows, or"
                " take the <mimic> away."
            )
        if first in held or not joints.moves(first):
            at = held[first].value if first in held else 0.0
            value = _number_attribute(mimic, "multiplier", 1.0) * at + _number_attribute(
                mimic, "offset", 0.0
            )
            held[name] = HeldJoint(name, value, f"follows {first}")
        elif name in held or all_:
            rest = _value_within_limits(joints, name, None)
            held[name] = HeldJoint(name, rest, f"follows {first}, which moves")
        else:
            raise RobotError(
                f"{path}: joint {name!r} follows {first!r} (mimic), which moves; an arm is planned"
                " with joints that move on their own. Hold one of the two in a robot file, such as"
                f" lock = {{ {name} = 0.0 }} (`stiffopt init robot {path.name}` writes one), or"
                " name a tip before it."
            )


def _value_within_limits(joints: JointTree, name: str, value: float | None) -> float:
    """Check a value against the limits of a joint; default the value nearest to zero."""
    joint = joints.joints[name]
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return value or 0.0
    low, high = (_number_attribute(limit, key, 0.0) for key in ("lower", "upper"))
    if value is None:
        return min(max(0.0, low), high) if low < high else 0.0
    if low < high and not low - 1e-9 <= value <= high + 1e-9:
        raise RobotError(
            f"lock: {name} is held at {value:g}, its limits are {low:g} to {high:g}."
            " Hold it within."
        )
    return value


def _number_attribute(element: ET.Element, key: str, default: float) -> float:
    try:
        return float(element.get(key, default))
    except ValueError:
        return default


def _fix_joint(joint: ET.Element, value: float) -> None:
    """Replace a joint by a fixed one at a position [rad] or [m]."""
    origin, axis = joint.find("origin"), joint.find("axis")
    place = np.array(_vector_attribute(origin, "xyz", "0 0 0"))
    turn = rotation_from_rpy(_vector_attribute(origin, "rpy", "0 0 0"))
    along = np.array(_vector_attribute(axis, "xyz", "1 0 0"))
    along = along / max(float(np.linalg.norm(along)), 1e-300)
    if joint.get("type") == "prismatic":
        place = place + turn @ along * value
    else:
        turn = turn @ rotation_about_axis(along, value)
    joint.set("type", "fixed")
    for part in ("axis", "limit", "dynamics", "mimic", "origin"):
        for found in joint.findall(part):
            joint.remove(found)
    rpy = rpy_from_rotation(turn)
    ET.SubElement(joint, "origin", xyz=numbers_text(place), rpy=numbers_text(rpy))


def _vector_attribute(element: ET.Element | None, key: str, default: str) -> list[float]:
    text = default if element is None else element.get(key, default)
    return [float(part) for part in text.split()]
