"""A URDF as a pinocchio model of revolute and prismatic joints, checked before it is read."""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import pinocchio as pin

from stiffopt.errors import InputFileError, RobotError, shortened
from stiffopt.robot.held_joints import HeldJoint, hold_joints
from stiffopt.robot.urdf_tree import read_tree

_KINDS = ("revolute", "continuous", "prismatic", "fixed")
# Stands in for the limits of a continuous joint, which pinocchio would read as a unit circle.
UNLIMITED = 1e9
# Beyond any machine in every unit of a URDF, far below what overflows when multiplied.
_LARGEST = 1e9
# Limits that are meant as none are written larger.
_NO_LIMIT = 1e30


@dataclass(frozen=True, eq=False)
class LoadedUrdf:
    """A URDF as a model.

    Parameters
    ----------
    model : pinocchio.Model
        Fixed and held joints merged; a continuous joint is a revolute one without position limits.
    joints : mapping of joint name to its `effort`, `velocity`, `damping`, `friction`
        0 where the URDF is silent. [N m], [rad/s], [N m s/rad], [N m]
    held : tuple of HeldJoint
        Moving joints that the arm does not move.
    """

    model: pin.Model
    joints: dict[str, dict[str, float]]
    held: tuple[HeldJoint, ...] = ()


def load_urdf(
    path: str | os.PathLike[str],
    *,
    lock: Mapping[str, float] | None = None,
    tip: str | None = None,
    keep: Collection[str] = (),
) -> LoadedUrdf:
    """Model of a URDF and what it says about each joint.

    Parameters
    ----------
    path : path of a URDF file
    lock : mapping of joint name to float, optional
        Joints that are held, and where [rad] or [m].
    tip : str, optional
        Link at the end of the arm; joints that do not lead to it are held.
    keep : collection of str
        Joints that move all the same.

    Raises
    ------
    RobotError
        A joint that is neither revolute, prismatic nor fixed, or follows another of the arm; a
        number that is missing or cannot be.
    """
    path = Path(path)
    tree = read_tree(path)
    _check_links(tree, path)
    moving = {}
    for joint in tree.findall("joint"):
        found = _joint(joint, path)
        if found is not None:
            moving[joint.get("name", "")] = found
    held = hold_joints(tree, path, lock=lock or {}, tip=tip, keep=keep)
    for each in held:
        del moving[each.name]
    if not moving:
        raise RobotError(f"{path}: no joint moves. Give an arm with revolute or prismatic joints.")
    try:
        model = pin.buildModelFromXML(ET.tostring(tree, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise InputFileError(path, "", f"cannot be read as a URDF: {shortened(error)}.") from error
    return LoadedUrdf(model, moving, held)


def _joint(joint: ET.Element, path: Path) -> dict[str, float] | None:
    """Check one joint; None if it is fixed."""
    name, kind = joint.get("name", ""), joint.get("type", "")
    if kind not in _KINDS:
        raise RobotError(
            f"{path}: joint {name!r} is of the kind {kind!r}; allowed are "
            f"{', '.join(_KINDS)}. Fix it, or replace it by several of these."
        )
    origin = joint.find("origin")
    if origin is not None:
        for key in ("xyz", "rpy"):
            urdf_numbers(origin.get(key, "0 0 0"), 3, f"{path}: joint {name!r}, origin {key}")
    if kind == "fixed":
        return None
    axis = joint.find("axis")
    if axis is not None:
        direction = urdf_numbers(axis.get("xyz", "1 0 0"), 3, f"{path}: joint {name!r}, axis")
        if math.hypot(*direction) == 0.0:
            raise RobotError(f"{path}: joint {name!r} has the axis 0 0 0. Give its direction.")
    limit = joint.find("limit")
    values = {}
    for key in ("effort", "velocity", "lower", "upper"):
        text = "0" if limit is None else limit.get(key, "0")
        values[key] = urdf_numbers(text, 1, f"{path}: joint {name!r}, limit {key}", _NO_LIMIT)[0]
    if kind == "continuous":
        joint.set("type", "revolute")
        limit = ET.SubElement(joint, "limit") if limit is None else limit
        limit.set("lower", str(-UNLIMITED))
        limit.set("upper", str(UNLIMITED))
        limit.set("effort", limit.get("effort", "0"))
        limit.set("velocity", limit.get("velocity", "0"))
    elif limit is None or not values.pop("lower") < values.pop("upper"):
        raise RobotError(
            f"{path}: joint {name!r} needs limits with lower below upper. "
            "Give <limit lower upper effort velocity>, or make it continuous."
        )
    dynamics = joint.find("dynamics")
    for key in ("damping", "friction"):
        text = "0" if dynamics is None else dynamics.get(key, "0")
        values[key] = urdf_numbers(text, 1, f"{path}: joint {name!r}, dynamics {key}")[0]
    return values


def _check_links(tree: ET.Element, path: Path) -> None:
    for link in tree.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        place = f"{path}: link {link.get('name')!r}"
        origin, mass, inertia = (inertial.find(k) for k in ("origin", "mass", "inertia"))
        if origin is not None:
            for key in ("xyz", "rpy"):
                urdf_numbers(origin.get(key, "0 0 0"), 3, f"{place}, origin {key}")
        if mass is not None and urdf_numbers(mass.get("value", ""), 1, f"{place}, mass")[0] < 0.0:
            raise RobotError(f"{place}: the mass {mass.get('value')} is below 0. Correct it.")
        for key, text in () if inertia is None else inertia.attrib.items():
            value = urdf_numbers(text, 1, f"{place}, inertia {key}")[0]
            if key in ("ixx", "iyy", "izz") and value < 0.0:
                raise RobotError(f"{place}: {key} = {text} is below 0. Correct it.")


def urdf_numbers(text: str, count: int, place: str, most: float = _LARGEST) -> list[float]:
    """Finite numbers of an attribute, `count` of them, none larger than `most`."""
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(v) for v in values):
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        got = shortened(text)
        raise RobotError(f"{place}: got {got}, allowed is {wanted}. Correct the URDF.")
    if any(abs(v) > most for v in values):
        got = shortened(text)
        raise RobotError(f"{place}: {got} is beyond any machine. Correct the URDF.")
    return values
