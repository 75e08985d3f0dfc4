"""URDF: file of the recorded arm with diagnosed friction and inertias, otherwise unchanged."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from stiffopt.export.model_format import MODEL_FORMATS, DiagnosedRobot, ModelFormat, notes
from stiffopt.robot.joint_tree import PLANNED_KINDS, link_attribute
from stiffopt.robot.mjcf import is_mjcf, read_mjcf
from stiffopt.robot.mjcf_tree import build_tree
from stiffopt.robot.xml_files import parse_xml, set_inertial


class Urdf(ModelFormat):
    """New `<dynamics>` of every joint and `<inertial>` of changed bodies.

    A changed body comprises its link and all links fixed to it: the first gets the whole inertia,
    the others keep only their shapes. URDF has no rotor inertia; the comment at its head states it.
    Of an MJCF a URDF without shapes is made, with rotor inertias as `armature` of `<dynamics>`.
    """

    name = "urdf"
    file = "found.urdf"

    def text(self, found: DiagnosedRobot) -> str:
        """Return the content of found.urdf."""
        root = _original_tree(found)
        for number, line in enumerate(notes(found)):
            root.insert(number, ET.Comment(f" {line.replace('--', '- -')} "))
        joints = {joint.get("name"): joint for joint in root.findall("joint")}
        links = {link.get("name"): link for link in root.findall("link")}
        for j, name in enumerate(found.robot.joint_names):
            joint = joints[name]
            dynamics = joint.find("dynamics")
            if dynamics is None:
                dynamics = ET.SubElement(joint, "dynamics")
            dynamics.set("damping", repr(float(found.robot.viscous[j])))
            dynamics.set("friction", repr(float(found.robot.coulomb[j])))
            if "armature" in dynamics.attrib:
                dynamics.set("armature", repr(float(found.robot.rotor_inertia[j])))
            old, new = found.nominal.tree.bodies[j], found.robot.tree.bodies[j]
            if not np.allclose(old.inertial_parameters, new.inertial_parameters, rtol=1e-9):
                carried = _carried_links(root, joint)
                set_inertial(links[carried[0]], new.mass, new.centre, new.inertia, rpy="0 0 0")
                for other in carried[1:]:
                    for inertial in links[other].findall("inertial"):
                        links[other].remove(inertial)
        ET.indent(root)
        return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _original_tree(found: DiagnosedRobot) -> ET.Element:
    """Return the robot's URDF with its comments, or the URDF of its MJCF."""
    path = found.nominal.urdf
    assert path is not None
    if not is_mjcf(path):
        return parse_xml(path, comments=True)
    root = build_tree(read_mjcf(path))
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    held = {each.name for each in found.nominal.held}
    for name, joint in joints.items():
        # Other readers know no free and ball joints.
        if name in held and joint.get("type") not in PLANNED_KINDS:
            joint.set("type", "fixed")
    for j, name in enumerate(found.nominal.joint_names):
        limit = joints[name].find("limit")
        assert limit is not None
        limit.set("effort", repr(float(found.nominal.torque_max[j])))
        limit.set("velocity", repr(float(found.nominal.velocity_max[j])))
    return root


def _carried_links(root: ET.Element, joint: ET.Element) -> list[str]:
    """Links that a joint carries: its own, then those fixed to it."""
    found = [link_attribute(joint, "child")]
    for link in found:
        found += [
            link_attribute(each, "child")
            for each in root.findall("joint")
            if each.get("type") == "fixed" and link_attribute(each, "parent") == link
        ]
    return found


MODEL_FORMATS.add(Urdf())
