"""Loading of URDFs and MJCFs as pinocchio models of revolute and prismatic joints, with checks."""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from stiffopt.errors import InputFileError, RobotError, nearest, shortened
from stiffopt.robot.body_tree import Body, body_tree
from stiffopt.robot.held_joints import HeldJoint, fix_free_joints, hold_joints
from stiffopt.robot.joint_tree import PLANNED_KINDS, JointTree
from stiffopt.robot.mjcf import is_mjcf
from stiffopt.robot.urdf_xml import read_urdf_tree
from stiffopt.robot.xml_files import set_inertial

_JOINT_KINDS = (*PLANNED_KINDS, "fixed")
# Beyond any machine in every unit of a URDF; products of a few such numbers do not overflow. Also
# the limits of a continuous joint, which pinocchio would otherwise model by a unit circle.
UNLIMITED = 1e9
# Distance of successive joints of an arm [m].
_MAX_JOINT_DISTANCE = 50.0
_INERTIA_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
# Radius of gyration of a link [m].
_MAX_GYRATION_RADIUS = 10.0
# Size of an atom [m].
_MIN_GYRATION_RADIUS = 1e-10
# Share of an arm's mass or inertia below which a body is negligible.
_MIN_INERTIAL_SHARE = 1e-3
# Share of the largest principal moment by which the least may be below 0, by rounding in files.
_MOMENT_ROUNDING = 1e-2
# Limits are accepted up to here, since files write huge numbers for no limit.
_MAX_LIMIT = 1e30


@dataclass(frozen=True, eq=False)
class LoadedUrdf:
    """Model of a URDF and its joints."""

    # Fixed and held joints merged; a continuous joint is a revolute one without position limits.
    model: pin.Model
    # By joint name: in the model's order; 0 where not given. [N m], [rad/s], [N m s/rad], [N m],
    # [kg m^2].
    joints: dict[str, dict[str, float]]
    held: tuple[HeldJoint, ...] = ()  # joints that are held fixed
    # Joints without the position limits that they need; unlimited in the model.
    unlimited: tuple[str, ...] = ()
    format: str = "URDF"  # "URDF" or "MJCF"

    @property
    def joints_without_masses(self) -> list[int]:
        """Joints, from 1, whose links have no mass or a placeholder in its place.

        Placeholders are several equal masses at the origins of their joints, with one moment of
        inertia about all axes: no link is such a body. None of an MJCF: MuJoCo refuses moving
        bodies without mass, and several joints of one body have links without mass between them.
        """
        if self.format == "MJCF":
            return []
        bodies = body_tree(self.model).bodies
        points = Counter(body.mass for body in bodies if _is_point_mass(body))
        return [
            j
            for j, body in enumerate(bodies, start=1)
            if not body.mass > 0.0
            or (_is_point_mass(body) and points[body.mass] >= _MIN_EQUAL_PLACEHOLDERS)
        ]


# Memory of the dynamics grows with the cube: 900 joints need 35 GB.
MAX_MOVING_JOINTS = 50


# Least number of equal point masses that are taken for placeholders: a flange may be one.
_MIN_EQUAL_PLACEHOLDERS = 3


def _is_point_mass(body: Body) -> bool:
    """True for a body with its centre at its joint and one moment of inertia about all axes."""
    alike = np.allclose(body.inertia, body.inertia[0, 0] * np.eye(3))
    return body.mass > 0.0 and not body.centre.any() and alike


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkBody:
    """Mass and inertia of a link, in place of those of the URDF."""

    mass: float  # [kg]
    com: np.ndarray  # (3,) centre of mass in the frame of the link [m]
    inertia: np.ndarray  # (3, 3) about the centre of mass, in the axes of the link [kg m^2]


def load_urdf(
    path: str | os.PathLike[str],
    *,
    lock: Mapping[str, float] | None = None,
    tip: str | None = None,
    keep: Collection[str] = (),
    limited: Collection[str] | None = (),
    bodies: Mapping[str, LinkBody] | None = None,
    hold_unplanned: bool = False,
) -> LoadedUrdf:
    """Load a URDF or MJCF as a model with the limits and friction of each joint.

    `lock` gives positions of locked joints [rad] or [m]; joints that do not lead to the link `tip`
    are held, except those in `keep`. Position limits of joints in `limited` are given elsewhere
    (None: of all). `bodies` replace inertials. With `hold_unplanned`, free bases, ball joints and
    followers of joints of the arm are fixed, in place of a `RobotError`, which missing or
    impossible numbers raise as well.
    """
    path = Path(path)
    tree = read_urdf_tree(path)
    _check_links(tree, path)
    _replace_inertials(tree, bodies or {}, path)
    free = fix_free_joints(tree, lock=lock or {}, tip=tip, all_=hold_unplanned)
    moving = {}
    for joint in tree.findall("joint"):
        found = _check_joint(joint, path)
        if found is not None:
            moving[joint.get("name", "")] = found
    fixed = {each.name for each in free}
    stated = {name: value for name, value in (lock or {}).items() if name not in fixed}
    held = hold_joints(tree, path, lock=stated, tip=tip, keep=keep, followers=hold_unplanned)
    for each in held:
        del moving[each.name]
    unlimited = [joint for joint in tree.findall("joint") if _needs_limits(joint)]
    for joint in unlimited:
        _remove_limits(joint, path, limited)
    if not moving:
        raise RobotError(f"{path}: no joint moves. Give an arm with revolute or prismatic joints.")
    if len(moving) > MAX_MOVING_JOINTS:
        raise RobotError(
            f"{path}: {len(moving)} joints move, at most {MAX_MOVING_JOINTS} are read. Lock those"
            " that are not of the arm, or name its tip."
        )
    try:
        model = pin.buildModelFromXML(ET.tostring(tree, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise InputFileError(path, "", f"cannot be read as a URDF: {shortened(error)}.") from error
    # A URDF may list its joints in any order.
    joints = {name: moving[name] for name in list(model.names)[1:]}
    return LoadedUrdf(
        model,
        joints,
        held=(*free, *held),
        unlimited=tuple(joint.get("name", "") for joint in unlimited),
        format="MJCF" if is_mjcf(path) else "URDF",
    )


def _check_joint(joint: ET.Element, path: Path) -> dict[str, float] | None:
    """Check one joint and read its limits and friction; None if it is fixed."""
    name, kind = joint.get("name", ""), joint.get("type", "")
    if kind not in _JOINT_KINDS:
        raise RobotError(
            f"{path}: joint {name!r} is of the kind {kind!r}; allowed are "
            f"{', '.join(_JOINT_KINDS)}. Replace it by several of these, or fix it where it is:"
            f" lock = {{ {name} = 0.0 }} in a robot file (`stiffopt init robot {path.name}` writes"
            " one)."
        )
    _check_origin(joint, path)
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
        values[key] = urdf_numbers(text, 1, f"{path}: joint {name!r}, limit {key}", _MAX_LIMIT)[0]
        if key in ("effort", "velocity") and values[key] < 0.0:
            raise RobotError(
                f"{path}: joint {name!r}, limit {key} = {text} is below 0. Correct the file."
            )
        if limit is not None and key in ("effort", "velocity"):
            limit.set(key, text)
    lower, upper = values.pop("lower"), values.pop("upper")
    if kind == "continuous":
        joint.set("type", "revolute")
        _set_limits(joint, -UNLIMITED, UNLIMITED)
    elif lower > upper or (lower == upper and lower != 0.0):
        raise RobotError(
            f"{path}: joint {name!r} needs limits with lower below upper, not {lower:g} and"
            f" {upper:g}. Give <limit lower upper effort velocity>, or make it continuous."
        )
    dynamics = joint.find("dynamics")
    for key in ("damping", "friction", "armature"):
        text = "0" if dynamics is None else dynamics.get(key, "0")
        values[key] = urdf_numbers(text, 1, f"{path}: joint {name!r}, dynamics {key}")[0]
    return values


def _check_origin(joint: ET.Element, path: Path) -> None:
    name, origin = joint.get("name", ""), joint.find("origin")
    if origin is None:
        return
    for key in ("xyz", "rpy"):
        at = urdf_numbers(origin.get(key, "0 0 0"), 3, f"{path}: joint {name!r}, origin {key}")
        if key == "xyz" and math.hypot(*at) > _MAX_JOINT_DISTANCE:
            raise RobotError(
                f"{path}: joint {name!r} lies {math.hypot(*at):g} m from the one before."
                " Lengths of a URDF are in m: was it exported in mm?"
            )


def _set_limits(joint: ET.Element, lower: float, upper: float) -> None:
    limit = joint.find("limit")
    limit = ET.SubElement(joint, "limit") if limit is None else limit
    limit.set("lower", str(lower))
    limit.set("upper", str(upper))
    for key in ("effort", "velocity"):
        limit.set(key, limit.get(key, "0"))


def _needs_limits(joint: ET.Element) -> bool:
    """Return whether position limits are missing, or both zero as some exporters write."""
    limit = joint.find("limit")
    if joint.get("type") == "fixed":
        return False
    return limit is None or float(limit.get("lower", 0)) == float(limit.get("upper", 0)) == 0.0


def _remove_limits(joint: ET.Element, path: Path, limited: Collection[str] | None) -> None:
    """Remove the limits of a joint whose limits are given elsewhere."""
    name = joint.get("name", "")
    if limited is not None and name not in limited:
        raise RobotError(
            f"{path}: joint {name!r} has no limits of position, or 0 and 0. Give <limit lower upper"
            " effort velocity> in the URDF, or position_lower and position_upper in a robot file"
            f" (`stiffopt init robot {path.name}` writes one)."
        )
    _set_limits(joint, -UNLIMITED, UNLIMITED)


def _replace_inertials(tree: ET.Element, bodies: Mapping[str, LinkBody], path: Path) -> None:
    links = {link.get("name", ""): link for link in tree.findall("link")}
    for name, body in bodies.items():
        if name not in links:
            raise RobotError(f"{path}: there is no link {name!r}. {nearest(name, links)}")
        set_inertial(links[name], body.mass, body.com, body.inertia)


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
        # Libraries would treat an incomplete inertial as a massless link.
        lacking = [k for k in _INERTIA_KEYS if inertia is None or inertia.get(k) is None]
        if mass is None or lacking:
            absent = "<mass>" if mass is None else ", ".join(lacking)
            raise RobotError(
                f"{place}: its <inertial> lacks {absent}. Give mass and all of"
                f" {', '.join(_INERTIA_KEYS)}."
            )
        for key, text in () if inertia is None else inertia.attrib.items():
            value = urdf_numbers(text, 1, f"{place}, inertia {key}")[0]
            if key in ("ixx", "iyy", "izz") and value < 0.0:
                raise RobotError(f"{place}: {key} = {text} is below 0. Correct it.")
    _check_gyrations(tree, path)


def _check_gyrations(tree: ET.Element, path: Path) -> None:
    """Raise `RobotError` for an unphysical or too large inertia of a moving link."""
    joints = JointTree(tree)
    bodies = {
        name: _mass_and_inertia(inertial)
        for link in tree.findall("link")
        if joints.carries(name := link.get("name", ""))
        and (inertial := link.find("inertial")) is not None
    }
    arm = sum(mass for mass, _ in bodies.values())
    moments = {name: float(inertia.diagonal().max()) for name, (_, inertia) in bodies.items()}
    for name, (mass, inertia) in bodies.items():
        moment = moments[name]
        if 0.0 < moment < mass * _MIN_GYRATION_RADIUS**2:
            raise RobotError(
                f"{path}: link {name!r}: {mass:g} kg with {moment:g} kg m^2 lie within an atom."
                " Give the moments of the body, or 0 for a mass in one point."
            )
        # Frames of tools or sensors often have arbitrary small numbers.
        others = sum(own for other, own in moments.items() if other != name)
        if not (
            mass > _MIN_INERTIAL_SHARE * arm or np.abs(inertia).max() > _MIN_INERTIAL_SHARE * others
        ):
            continue
        if mass * _MAX_GYRATION_RADIUS**2 < moment and mass > 0.0:
            raise RobotError(
                f"{path}: link {name!r}: {mass:g} kg with {moment:g} kg m^2 lie"
                f" {math.sqrt(moment / mass):.3g} m from their centre. Inertias of a URDF are in"
                " kg m^2: were they exported in kg mm^2 or g mm^2?"
            )
        principal = np.linalg.eigvalsh(inertia)
        slack = _MOMENT_ROUNDING * np.abs(principal).max()
        # One above the sum of the others occurs in many files and is only reported.
        if principal[0] < -slack:
            raise RobotError(
                f"{path}: link {name!r}: its principal moments"
                f" {', '.join(f'{each:.4g}' for each in principal)} kg m^2 belong to no body: none"
                " may be below 0. Correct ixx to izz: is a moment in place of ixy, ixz or iyz, or"
                " are they in another unit?"
            )


def _mass_and_inertia(inertial: ET.Element) -> tuple[float, np.ndarray]:
    """Mass [kg] and inertia (3, 3) in the frame of the inertial [kg m^2]."""
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    assert mass is not None
    assert inertia is not None
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, 0.0)) for key in _INERTIA_KEYS)
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return float(mass.get("value", 0.0)), tensor


def urdf_numbers(text: str, count: int, place: str, most: float = UNLIMITED) -> list[float]:
    """Parse `count` finite numbers of an attribute, none larger than `most`."""
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(v) for v in values):
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        got = shortened(text)
        raise RobotError(f"{place}: got {got}, allowed is {wanted}. Correct the file.")
    if any(abs(v) > most for v in values):
        got = shortened(text)
        raise RobotError(f"{place}: {got} is beyond any machine. Correct the file.")
    return values
