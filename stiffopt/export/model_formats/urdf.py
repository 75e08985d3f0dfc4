"""URDF: file of the recorded arm with diagnosed friction and inertias, otherwise unchanged."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from stiffopt.export.model_format import MODEL_FORMATS, DiagnosedRobot, ModelFormat, notes
from stiffopt.robot.body_tree import Body
from stiffopt.robot.xml_files import parse_xml


class Urdf(ModelFormat):
    """New `<dynamics>` of every joint and `<inertial>` of changed bodies.

    Notes
    -----
    A changed body comprises its link and all links fixed to it: the first gets the whole inertia,
    the others keep only their shapes. URDF has no rotor inertia; the comment at its head states it.
    """

    name = "urdf"
    file = "found.urdf"

    def text(self, found: DiagnosedRobot) -> str:
        """Return the content of found.urdf."""
        # Keep the comments of the file.
        assert found.nominal.urdf is not None
        root = parse_xml(found.nominal.urdf, comments=True)
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
            old, new = found.nominal.tree.bodies[j], found.robot.tree.bodies[j]
            if not np.allclose(old.inertial_parameters, new.inertial_parameters, rtol=1e-9):
                carried = _carried_links(root, joint)
                _set_inertial(links[carried[0]], new)
                for other in carried[1:]:
                    for inertial in links[other].findall("inertial"):
                        links[other].remove(inertial)
        ET.indent(root)
        return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _carried_links(root: ET.Element, joint: ET.Element) -> list[str]:
    """Links that a joint carries: its own, then those fixed to it."""
    found = [_link_name(joint, "child")]
    for link in found:
        found += [
            _link_name(each, "child")
            for each in root.findall("joint")
            if each.get("type") == "fixed" and _link_name(each, "parent") == link
        ]
    return found


def _link_name(joint: ET.Element, which: str) -> str:
    end = joint.find(which)
    return "" if end is None else end.get("link", "")


def _set_inertial(link: ET.Element, body: Body) -> None:
    """Set the inertial of the whole body in the link frame, which is the joint's."""
    for inertial in link.findall("inertial"):
        link.remove(inertial)
    inertial = ET.SubElement(link, "inertial")
    place = " ".join(repr(float(x)) for x in body.centre)
    ET.SubElement(inertial, "origin", xyz=place, rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(float(body.mass)))
    ET.SubElement(
        inertial,
        "inertia",
        {
            f"i{'xyz'[a]}{'xyz'[b]}": repr(float(body.inertia[a, b]))
            for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        },
    )


MODEL_FORMATS.add(Urdf())
