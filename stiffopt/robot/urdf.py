"""A URDF as a pinocchio model of revolute and prismatic joints, checked before it is read."""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from stiffopt.errors import InputFileError, RobotError, nearest, shortened
from stiffopt.robot.held_joints import HeldJoint, hold_joints
from stiffopt.robot.urdf_tree import read_tree

_KINDS = ("revolute", "continuous", "prismatic", "fixed")
# Stands in for the limits of a continuous joint, which pinocchio would read as a unit circle.
UNLIMITED = 1e9
# Beyond any machine in every unit of a URDF, far below what overflows when multiplied.
_LARGEST = 1e9
# No arm has joints so far apart [m].
_FAR = 50.0
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
# No link of an arm has its mass so far from its centre [m].
_WIDE = 10.0
# No body of a robot is smaller than an atom [m].
_ATOM = 1e-10
# A smaller share of an arm's mass or inertia does not matter.
_MATTERS = 1e-3
# Share of the largest principal moment by which the least may be below 0: files are rounded.
_ROUNDED = 1e-2
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
        In the model's order; 0 where the URDF is silent. [N m], [rad/s], [N m s/rad], [N m]
    held : tuple of HeldJoint
        Moving joints that the arm does not move.
    unlimited : tuple of str
        Joints that need limits of position, which the URDF does not state; without any in the
        model.
    """

    model: pin.Model
    joints: dict[str, dict[str, float]]
    held: tuple[HeldJoint, ...] = ()
    unlimited: tuple[str, ...] = ()


# Memory of the dynamics grows with their cube: 900 joints take 35 GB.
MAX_MOVING_JOINTS = 50


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkBody:
    """What a link weighs, in place of what the URDF says.

    Parameters
    ----------
    mass : float [kg]
    com : array (3,)
        Centre of mass in the frame of the link [m].
    inertia : array (3, 3)
        About the centre of mass, in the axes of the link [kg m^2].
    """

    mass: float
    com: np.ndarray
    inertia: np.ndarray


def load_urdf(
    path: str | os.PathLike[str],
    *,
    lock: Mapping[str, float] | None = None,
    tip: str | None = None,
    keep: Collection[str] = (),
    limited: Collection[str] | None = (),
    bodies: Mapping[str, LinkBody] | None = None,
    followers: bool = False,
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
    limited : collection of str or None
        Joints whose limits of position are given elsewhere; None: all that need some.
    bodies : mapping of link name to LinkBody, optional
        In place of the URDF's inertials.
    followers : bool
        Hold joints of the arm that follow another one, in place of an error.

    Raises
    ------
    RobotError
        A joint that is neither revolute, prismatic nor fixed, or follows another of the arm; a
        number that is missing or cannot be.
    """
    path = Path(path)
    tree = read_tree(path)
    _check_links(tree, path)
    _put_bodies(tree, bodies or {}, path)
    moving = {}
    for joint in tree.findall("joint"):
        found = _joint(joint, path)
        if found is not None:
            moving[joint.get("name", "")] = found
    held = hold_joints(tree, path, lock=lock or {}, tip=tip, keep=keep, followers=followers)
    for each in held:
        del moving[each.name]
    unlimited = [joint for joint in tree.findall("joint") if _needs_limits(joint)]
    for joint in unlimited:
        _free(joint, path, limited)
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
    return LoadedUrdf(model, joints, held, tuple(joint.get("name", "") for joint in unlimited))


def _joint(joint: ET.Element, path: Path) -> dict[str, float] | None:
    """Check one joint; None if it is fixed."""
    name, kind = joint.get("name", ""), joint.get("type", "")
    if kind not in _KINDS:
        raise RobotError(
            f"{path}: joint {name!r} is of the kind {kind!r}; allowed are "
            f"{', '.join(_KINDS)}. Fix it, or replace it by several of these."
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
        values[key] = urdf_numbers(text, 1, f"{path}: joint {name!r}, limit {key}", _NO_LIMIT)[0]
        if key in ("effort", "velocity") and values[key] < 0.0:
            raise RobotError(
                f"{path}: joint {name!r}, limit {key} = {text} is below 0. Correct the URDF."
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
    for key in ("damping", "friction"):
        text = "0" if dynamics is None else dynamics.get(key, "0")
        values[key] = urdf_numbers(text, 1, f"{path}: joint {name!r}, dynamics {key}")[0]
    return values


def _check_origin(joint: ET.Element, path: Path) -> None:
    name, origin = joint.get("name", ""), joint.find("origin")
    if origin is None:
        return
    for key in ("xyz", "rpy"):
        at = urdf_numbers(origin.get(key, "0 0 0"), 3, f"{path}: joint {name!r}, origin {key}")
        if key == "xyz" and math.hypot(*at) > _FAR:
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
    """Whether limits of position are not stated: none, or both zero as exporters leave them."""
    limit = joint.find("limit")
    if joint.get("type") == "fixed":
        return False
    return limit is None or float(limit.get("lower", 0)) == float(limit.get("upper", 0)) == 0.0


def _free(joint: ET.Element, path: Path, limited: Collection[str] | None) -> None:
    """Take the limits of a joint away that something else gives."""
    name = joint.get("name", "")
    if limited is not None and name not in limited:
        raise RobotError(
            f"{path}: joint {name!r} has no limits of position, or 0 and 0. Give <limit lower upper"
            " effort velocity> in the URDF, or position_lower and position_upper in a robot file"
            f" (`stiffopt init robot {path.name}` writes one)."
        )
    _set_limits(joint, -UNLIMITED, UNLIMITED)


def _put_bodies(tree: ET.Element, bodies: Mapping[str, LinkBody], path: Path) -> None:
    links = {link.get("name", ""): link for link in tree.findall("link")}
    for name, body in bodies.items():
        if name not in links:
            raise RobotError(f"{path}: there is no link {name!r}. {nearest(name, links)}")
        for found in links[name].findall("inertial"):
            links[name].remove(found)
        inertial = ET.SubElement(links[name], "inertial")
        ET.SubElement(inertial, "origin", xyz=" ".join(repr(float(x)) for x in body.com))
        ET.SubElement(inertial, "mass", value=repr(float(body.mass)))
        rows = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2),
                "izz": (2, 2)}  # fmt: skip
        ET.SubElement(
            inertial, "inertia", {k: repr(float(body.inertia[at])) for k, at in rows.items()}
        )


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
        # A library that misses one would go on with a link that weighs nothing.
        lacking = [k for k in _INERTIA if inertia is None or inertia.get(k) is None]
        if mass is None or lacking:
            what = "<mass>" if mass is None else ", ".join(lacking)
            raise RobotError(
                f"{place}: its <inertial> lacks {what}. Give mass and all of {', '.join(_INERTIA)}."
            )
        for key, text in () if inertia is None else inertia.attrib.items():
            value = urdf_numbers(text, 1, f"{place}, inertia {key}")[0]
            if key in ("ixx", "iyy", "izz") and value < 0.0:
                raise RobotError(f"{place}: {key} = {text} is below 0. Correct it.")
    _check_gyrations(tree, path)


def _check_gyrations(tree: ET.Element, path: Path) -> None:
    """Raise `RobotError` for an inertia that moves, matters and is that of no body, or too wide."""
    moved = _moved_links(tree)
    bodies = {
        link.get("name", ""): _mass_and_inertia(inertial)
        for link in tree.findall("link")
        if link.get("name") in moved and (inertial := link.find("inertial")) is not None
    }
    arm = sum(mass for mass, _ in bodies.values())
    moments = {name: float(inertia.diagonal().max()) for name, (_, inertia) in bodies.items()}
    for name, (mass, inertia) in bodies.items():
        moment = moments[name]
        if 0.0 < moment < mass * _ATOM**2:
            raise RobotError(
                f"{path}: link {name!r}: {mass:g} kg with {moment:g} kg m^2 lie within an atom."
                " Give the moments of the body, or 0 for a mass in one point."
            )
        # Frames for a tool or a sensor are given some small numbers at times.
        others = sum(own for other, own in moments.items() if other != name)
        if not (mass > _MATTERS * arm or np.abs(inertia).max() > _MATTERS * others):
            continue
        if mass * _WIDE**2 < moment and mass > 0.0:
            raise RobotError(
                f"{path}: link {name!r}: {mass:g} kg with {moment:g} kg m^2 lie"
                f" {math.sqrt(moment / mass):.3g} m from their centre. Inertias of a URDF are in"
                " kg m^2: were they exported in kg mm^2 or g mm^2?"
            )
        principal = np.linalg.eigvalsh(inertia)
        slack = _ROUNDED * np.abs(principal).max()
        # One above the sum of the others occurs in many files; `inconsistent_inertias` reports it.
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
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, 0.0)) for key in _INERTIA)
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return float(mass.get("value", 0.0)), tensor


def _moved_links(tree: ET.Element) -> set[str]:
    """Links that a joint which is not fixed carries, itself or through others."""
    moved: set[str] = set()
    joints = [
        (joint.get("type") != "fixed", joint.find("parent"), joint.find("child"))
        for joint in tree.findall("joint")
    ]
    found = True
    while found:
        carried = {
            child.get("link", "")
            for moves, parent, child in joints
            if child is not None and (moves or (parent is not None and parent.get("link") in moved))
        }
        found = not carried <= moved
        moved |= carried
    return moved


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
