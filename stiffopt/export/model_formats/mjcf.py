"""MJCF: the user's own file with diagnosed values; where the robot is a URDF, a new one."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import astuple, fields

import numpy as np
from scipy.spatial.transform import Rotation

from stiffopt.errors import RobotError
from stiffopt.export.mjcf_changes import AttributeChange, change_mjcf
from stiffopt.export.model_format import (
    MODEL_FORMATS,
    DiagnosedRobot,
    ExportedRobot,
    ModelFormat,
    notes,
)
from stiffopt.files import csv_text
from stiffopt.robot.body_tree import realisable_inertia, realisable_moments
from stiffopt.robot.mjcf import is_mjcf
from stiffopt.robot.xml_files import numbers_text

# MuJoCo's dry friction is a soft constraint: with these settings nearly full at 1 mrad/s.
_FRICTION_TIME, _FRICTION_IMPEDANCE = 0.002, "0.9999 0.9999 0.001 0.5 2"


# Table of the attributes that were changed.
CHANGES_FILE = "mjcf_changes.csv"


class Mjcf(ModelFormat):
    """Bodies with inertias, joints with `frictionloss`, `damping` and `armature`, motors.

    MuJoCo, XML reference. A motor's `gear` is the joint torque per commanded torque. Elastic joints
    become rigid; shapes are omitted.
    """

    name = "mjcf"
    file = "found.xml"

    def export(self, found: DiagnosedRobot) -> ExportedRobot:
        """Return the changed files of the robot's MJCF and the table of changes, or a new MJCF."""
        path = found.nominal.urdf
        if path is None or not is_mjcf(path):
            return ExportedRobot(
                files={self.file: self.text(found)}, remarks=tuple(self.remarks(found))
            )
        changed = change_mjcf(found, path)
        columns = [each.name for each in fields(AttributeChange)]
        table = csv_text(columns, (astuple(change) for change in changed.changes))
        return ExportedRobot(
            files=changed.contents | {CHANGES_FILE: table},
            remarks=tuple(f"not in the MJCF: {each}" for each in changed.left_out),
        )

    def text(self, found: DiagnosedRobot) -> str:
        """Return the content of found.xml."""
        robot = found.robot
        root = ET.Element("mujoco", model=found.name)
        for line in (*notes(found), *self.remarks(found)):
            root.append(ET.Comment(f" {line.replace('--', '- -')} "))
        ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
        gravity = robot.tree.gravity
        ET.SubElement(
            root,
            "option",
            gravity=numbers_text(gravity),
            timestep="0.0005",
            integrator="implicitfast",
        )
        places = {0: ET.SubElement(root, "worldbody")}
        for j, body in enumerate(robot.tree.bodies):
            places[j + 1] = self._add_body(places[body.parent], found, j)
        tool = robot.tool
        ET.SubElement(
            places[tool.joint],
            "site",
            name="tool",
            pos=numbers_text(tool.offset),
            quat=numbers_text(_to_quaternion(tool.rotation)),
        )
        actuators = ET.SubElement(root, "actuator")
        for j, name in enumerate(robot.joint_names):
            motor = {"name": f"{name}_motor", "joint": name, "gear": repr(float(found.gain[j]))}
            motor |= _range_attributes("ctrl", -robot.torque_max[j], robot.torque_max[j])
            ET.SubElement(actuators, "motor", motor)
        ET.indent(root)
        return ET.tostring(root, encoding="unicode") + "\n"

    def remarks(self, found: DiagnosedRobot) -> list[str]:
        """Name bodies whose inertia MuJoCo would refuse."""
        return [
            f"inertia behind {name} belongs to no rigid body, which MuJoCo refuses: moments of"
            f" {_format_moments(before)} kg m^2 become {_format_moments(after)}"
            for name, body in zip(found.robot.joint_names, found.robot.tree.bodies, strict=True)
            for before, _ in [np.linalg.eigh(body.inertia)]
            if (after := realisable_moments(before)) is not before
        ]

    def _add_body(self, parent: ET.Element, found: DiagnosedRobot, j: int) -> ET.Element:
        robot = found.robot
        body, name = robot.tree.bodies[j], robot.joint_names[j]
        if not body.mass > 0.0:
            raise RobotError(
                f"{found.name}: nothing behind joint {name!r} has a mass, and MuJoCo refuses a "
                "moving body without one. Give its link an <inertial>."
            )
        element = ET.SubElement(
            parent,
            "body",
            name=f"{name}_link",
            pos=numbers_text(body.translation),
            quat=numbers_text(_to_quaternion(body.rotation)),
        )
        # xx, yy, zz, xy, xz, yz about the centre of mass, in the body's axes.
        rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
        ET.SubElement(
            element,
            "inertial",
            pos=numbers_text(body.centre),
            mass=repr(float(body.mass)),
            fullinertia=numbers_text(realisable_inertia(body.inertia)[rows, columns]),
        )
        zero = found.zeros[j]
        joint = {
            "name": name,
            "type": "slide" if body.prismatic else "hinge",
            "axis": numbers_text(body.axis),
            "frictionloss": repr(float(robot.coulomb[j])),
            "damping": repr(float(robot.viscous[j])),
            "armature": repr(float(robot.rotor_inertia[j])),
            "solreffriction": f"{_FRICTION_TIME} 1",
            "solimpfriction": _FRICTION_IMPEDANCE,
            **_range_attributes("", robot.position_lower[j] - zero, robot.position_upper[j] - zero),
        }
        if zero != 0.0:
            joint["ref"] = repr(-float(zero))
        ET.SubElement(element, "joint", joint)
        return element


def _format_moments(moments: np.ndarray) -> str:
    return ", ".join(f"{each:.4g}" for each in moments)


def _range_attributes(kind: str, low: float, high: float) -> dict[str, str]:
    """Attributes of a finite range; empty for an infinite one."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return {}
    return {f"{kind}limited": "true", f"{kind}range": numbers_text([low, high])}


def _to_quaternion(rotation: np.ndarray) -> np.ndarray:
    """Convert a rotation to a quaternion w, x, y, z."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


MODEL_FORMATS.add(Mjcf())
