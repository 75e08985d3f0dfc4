"""Masses of links that a URDF leaves out, guessed from their shapes: something to begin with."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from stiffopt.robot.body_tree import body_tree
from stiffopt.robot.clearance import coal_form
from stiffopt.robot.frames import LinkFrame, first_link_of
from stiffopt.robot.link_shapes import LinkShape, read_link_shapes
from stiffopt.robot.skeleton import capsules, joint_radii
from stiffopt.robot.urdf import LinkBody, LoadedUrdf

# Of the convex hulls of links [kg/m^3]. The LBR iiwa, all aluminium, has 750 by its published
# masses; cast arms with their motors have more.
DENSITY = 1000.0
# A larger hull [m^3] is in millimetres, or no link.
_LARGEST = 8.0


def estimated_bodies(arm: LoadedUrdf, urdf: Path, tool: LinkFrame) -> dict[str, LinkBody]:
    """Bodies of links, where all that hangs on a joint has no mass.

    Parameters
    ----------
    arm : LoadedUrdf
    urdf : Path
        Of the arm, for its shapes.
    tool : LinkFrame
        At the end of the arm; where a link has no shape, it is taken as a rod to the next joint.
    """
    model, tree = arm.model, body_tree(arm.model)
    without = [j for j, body in enumerate(tree.bodies, start=1) if not body.mass > 0.0]
    if not without:
        return {}
    shapes = read_link_shapes(urdf)
    rods = {rod.joint: rod for rod in capsules(tree, tool)}
    radii = joint_radii(tree, tool)
    found: dict[str, LinkBody] = {}
    for joint in without:
        links = [
            frame.name
            for frame in model.frames
            if frame.type == pin.FrameType.BODY and frame.parentJoint == joint
        ]
        own = {name: body for name in links if (body := _of_shapes(name, shapes)) is not None}
        if not own:
            rod = rods.get(joint)
            begin, end = (np.zeros(3), np.zeros(3)) if rod is None else (rod.begin, rod.end)
            own = {first_link_of(model, joint): _of_rod(begin, end, radii[joint - 1])}
        found |= own
    return found


def _of_shapes(link: str, shapes: tuple[LinkShape, ...]) -> LinkBody | None:
    """Body of a link by its collision shapes, else its visual ones; None without any."""
    for purpose in ("collision", "visual"):
        parts = [
            part for s in shapes if s.link == link and s.purpose == purpose for part in _parts(s)
        ]
        if parts:
            return _together(parts)
    return None


def _parts(shape: LinkShape) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    form: Any = coal_form(shape)
    if form is not None and 0.0 < form.computeVolume() < _LARGEST:
        yield _mass_in_link(form, shape.rotation, shape.offset)


def _mass_in_link(
    form: Any, rotation: np.ndarray, offset: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre (3,) and inertia about the centre (3, 3) in the frame of the link."""
    mass = DENSITY * float(form.computeVolume())
    centre = rotation @ np.array(form.computeCOM()) + offset
    inertia = DENSITY * np.array(form.computeMomentofInertiaRelatedToCOM())
    return mass, centre, rotation @ inertia @ rotation.T


def _of_rod(begin: np.ndarray, end: np.ndarray, radius: float) -> LinkBody:
    """Body of a rod with round ends; of a ball where it has no length."""
    length = float(np.linalg.norm(end - begin))
    if length == 0.0:
        return _together([_mass_in_link(coal.Sphere(radius), np.eye(3), begin)])
    up = np.array([0.0, 0.0, 1.0])
    turn = pin.Quaternion.FromTwoVectors(up, (end - begin) / length).matrix()
    return _together([_mass_in_link(coal.Capsule(radius, length), turn, 0.5 * (begin + end))])


def _together(parts: list[tuple[float, np.ndarray, np.ndarray]]) -> LinkBody:
    mass = sum(part[0] for part in parts)
    com = np.sum([part[0] * part[1] for part in parts], axis=0) / mass
    inertia = np.zeros((3, 3))
    for own, centre, tensor in parts:
        arm = centre - com
        inertia += tensor + own * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return LinkBody(mass=float(mass), com=com, inertia=inertia)
