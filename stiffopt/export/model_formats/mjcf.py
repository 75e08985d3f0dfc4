"""MJCF: recorded arm for MuJoCo, with diagnosed friction, rotor inertia and gains."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from stiffopt.errors import RobotError
from stiffopt.export.model_format import MODEL_FORMATS, DiagnosedRobot, ModelFormat, notes

# MuJoCo's dry friction is a soft constraint: with these settings nearly full at 1 mrad/s.
_FRICTION_TIME, _FRICTION_IMPEDANCE = 0.002, "0.9999 0.9999 0.001 0.5 2"

# Least moments of inertia [kg m^2], and as a share of the largest, for rounding; MuJoCo refuses
# moments below 1e-15 kg m^2.
_MIN_MOMENT, _MIN_MOMENT_SHARE = 1e-9, 1e-6


class Mjcf(ModelFormat):
    """Bodies with inertias, joints with `frictionloss`, `damping` and `armature`, motors.

    Notes
    -----
    MuJoCo, XML reference. A motor's `gear` is the joint torque per commanded torque. Elastic joints
    become rigid; shapes are omitted.
    """

    name = "mjcf"
    file = "found.xml"

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
            gravity=_format_numbers(gravity),
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
            pos=_format_numbers(tool.offset),
            quat=_format_numbers(_to_quaternion(tool.rotation)),
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
            if (after := _realisable_moments(before)) is not before
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
            pos=_format_numbers(body.translation),
            quat=_format_numbers(_to_quaternion(body.rotation)),
        )
        # xx, yy, zz, xy, xz, yz about the centre of mass, in the body's axes.
        rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
        ET.SubElement(
            element,
            "inertial",
            pos=_format_numbers(body.centre),
            mass=repr(float(body.mass)),
            fullinertia=_format_numbers(_realisable_inertia(body.inertia)[rows, columns]),
        )
        joint = {
            "name": name,
            "type": "slide" if body.prismatic else "hinge",
            "axis": _format_numbers(body.axis),
            "frictionloss": repr(float(robot.coulomb[j])),
            "damping": repr(float(robot.viscous[j])),
            "armature": repr(float(robot.rotor_inertia[j])),
            "solreffriction": f"{_FRICTION_TIME} 1",
            "solimpfriction": _FRICTION_IMPEDANCE,
            **_range_attributes("", robot.position_lower[j], robot.position_upper[j]),
        }
        ET.SubElement(element, "joint", joint)
        return element


def _realisable_inertia(inertia: np.ndarray) -> np.ndarray:
    """Raise an inertia (3, 3) to that of a rigid body with the same largest moment."""
    moments, axes = np.linalg.eigh(inertia)
    raised = _realisable_moments(moments)
    return inertia if raised is moments else axes @ np.diag(raised) @ axes.T


def _realisable_moments(moments: np.ndarray) -> np.ndarray:
    """Raise ascending principal moments (3,) until the triangle inequality holds."""
    least = max(_MIN_MOMENT, _MIN_MOMENT_SHARE * moments[2])
    if moments[0] >= least and moments[0] + moments[1] >= moments[2]:
        return moments
    raised: np.ndarray = np.maximum(moments, least)
    lacking = float((1.0 + _MIN_MOMENT_SHARE) * raised[2] - raised[0] - raised[1])
    raised[:2] += 0.5 * max(lacking, 0.0)
    return raised


def _format_moments(moments: np.ndarray) -> str:
    return ", ".join(f"{each:.4g}" for each in moments)


def _range_attributes(kind: str, low: float, high: float) -> dict[str, str]:
    """Attributes of a finite range; empty for an infinite one."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return {}
    return {f"{kind}limited": "true", f"{kind}range": _format_numbers([low, high])}


def _to_quaternion(rotation: np.ndarray) -> np.ndarray:
    """Convert a rotation to a quaternion w, x, y, z."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def _format_numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


MODEL_FORMATS.add(Mjcf())
