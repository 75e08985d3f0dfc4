"""Bodies and joints of an MJCF as a tree of links and joints in the terms of a URDF.

A joint of MuJoCo turns about an anchor in its body's frame; several joints of a body act one after
another. The frame of a URDF's link lies at its joint: each joint gets a link at its anchor, and
where the anchor of the last is not the body's origin, the body is fixed to it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from stiffopt.robot.frames import rotation_about_axis, rpy_from_rotation
from stiffopt.robot.mjcf import WORLD, MjcfBody, MjcfJoint, MjcfModel, free_name
from stiffopt.robot.xml_files import numbers_text, set_inertial


def build_tree(model: MjcfModel) -> ET.Element:
    """Return `<robot>` with the links and joints of an MJCF.

    `<dynamics>` of a joint has `armature` besides `damping` and `friction`. Joints are of the kinds
    revolute, continuous, prismatic and fixed, or "free" and "ball", which an arm cannot have.
    """
    tree = ET.Element("robot", name="mjcf")
    taken = {WORLD, *(body.name for body in model.bodies)}
    ET.SubElement(tree, "link", name=WORLD)
    for body in model.bodies:
        _add_body(tree, body, [model.joints[name] for name in body.joints], taken)
    for site in model.sites:
        if site.name not in taken:
            taken.add(site.name)
            ET.SubElement(tree, "link", name=site.name)
            _fix_link(tree, site.parent, site.name, site.place, site.rotation)
    joints = {each.get("name"): each for each in tree.findall("joint")}
    for coupling in model.couplings:
        ET.SubElement(
            joints[coupling.follower],
            "mimic",
            joint=coupling.leader,
            multiplier=repr(coupling.slope),
            offset=repr(coupling.offset),
        )
    return tree


def _add_body(tree: ET.Element, body: MjcfBody, joints: list[MjcfJoint], taken: set[str]) -> None:
    parent, place, turn, before = body.parent, body.place, body.rotation, np.zeros(3)
    for joint in joints:
        last = joint is joints[-1] and not joint.anchor.any()
        child = body.name if last else free_name(f"{body.name}_{joint.name}", taken)
        _add_joint(tree, joint, parent, child, place + turn @ (joint.anchor - before), turn)
        if not last:
            ET.SubElement(tree, "link", name=child)
        parent, before, place, turn = child, joint.anchor, np.zeros(3), np.eye(3)
    if parent != body.name:
        _fix_link(tree, parent, body.name, place - turn @ before, turn)
    _add_link(tree, body)


def _add_link(tree: ET.Element, body: MjcfBody) -> None:
    link = ET.SubElement(tree, "link", name=body.name)
    if body.mass == 0.0 and not body.inertia.any():
        return
    set_inertial(link, body.mass, body.centre, body.inertia)


def _add_joint(
    tree: ET.Element, own: MjcfJoint, parent: str, child: str, place: np.ndarray, turn: np.ndarray
) -> None:
    joint = ET.SubElement(tree, "joint", name=own.name, type=own.kind)
    if own.kind not in ("hinge", "slide"):
        _connect_links(joint, parent, child, place, turn)
        return
    # The body is as in the file where the joint is at its reference.
    if own.kind == "slide":
        joint.set("type", "prismatic")
        place = place - turn @ own.axis * own.reference
    else:
        joint.set("type", "revolute" if own.limits else "continuous")
        turn = turn @ rotation_about_axis(own.axis, -own.reference)
    _connect_links(joint, parent, child, place, turn)
    ET.SubElement(joint, "axis", xyz=numbers_text(own.axis))
    limit = ET.SubElement(joint, "limit", effort=repr(own.torque_max), velocity="0.0")
    if own.limits:
        limit.set("lower", repr(own.limits[0]))
        limit.set("upper", repr(own.limits[1]))
    ET.SubElement(
        joint,
        "dynamics",
        damping=repr(own.damping),
        friction=repr(own.frictionloss),
        armature=repr(own.armature),
    )


def _fix_link(
    tree: ET.Element, parent: str, child: str, place: np.ndarray, turn: np.ndarray
) -> None:
    joint = ET.SubElement(tree, "joint", name=f"{child}_fixed", type="fixed")
    _connect_links(joint, parent, child, place, turn)


def _connect_links(
    joint: ET.Element, parent: str, child: str, place: np.ndarray, turn: np.ndarray
) -> None:
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    rpy = rpy_from_rotation(np.array(turn))
    ET.SubElement(joint, "origin", xyz=numbers_text(place), rpy=numbers_text(rpy))
