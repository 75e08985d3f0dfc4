"""Masses of links without inertials in a URDF, estimated from their shapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from stiffopt.errors import RobotError
from stiffopt.robot.body_tree import body_tree, joint_radii, link_capsules
from stiffopt.robot.clearance import coal_form
from stiffopt.robot.frames import LinkFrame, first_link_of
from stiffopt.robot.link_shapes import LinkShape, read_link_shapes
from stiffopt.robot.urdf import LinkBody, LoadedUrdf

# Density of the convex hulls of links [kg/m^3]. By published masses the LBR iiwa, of aluminium, has
# 750; cast arms with their motors have more.
DENSITY = 1000.0
# Density of a link without shape [kg/m^3]: a rod to the next joint and a housing of so many radii.
# Fitted to the mean logarithm of 19 arms with published masses (URDFs of KUKA, ABB, UR, Franka,
# Kinova, Rethink, Yaskawa, Staubli); one of three arms deviates by more than a factor of 1.55, or
# 1.45 after the fit to torque limits.
ROD_DENSITY = 850.0
_HOUSING_RADII = 2.7
# Usual torque limit over gravity torque, at the joint of the largest gravity torque.
_USUAL_TORQUE_RATIO = 2.0
# Below this an arm could hardly move.
_MIN_TORQUE_RATIO = 1.2
# Largest change of a rod's mass by the torque limits.
_MAX_MASS_FACTOR = 2.0
# Larger hulls are in millimetres or no links [m^3].
_MAX_LINK_VOLUME = 8.0


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatedBody(LinkBody):
    """Estimated body of a link."""

    shaped: bool = True  # the URDF has a shape of the link; else it is a rod to the next joint
    scale: float = 1.0  # factor on its mass by the torque limits


def estimate_bodies(arm: LoadedUrdf, urdf: Path, tool: LinkFrame) -> dict[str, EstimatedBody]:
    """Estimate bodies of links where all links of a joint have no mass or a placeholder.

    `urdf`: file with the shapes of the arm. `tool`: at the end of the arm, where a last link
    without shape ends. Raises `RobotError`: a link without shape of an arm without length.
    """
    model, tree = arm.model, body_tree(arm.model)
    without = arm.joints_without_masses
    if not without:
        return {}
    shapes = read_link_shapes(urdf)
    rods = {rod.joint: rod for rod in link_capsules(tree, tool)}
    radii = joint_radii(tree, tool)
    found: dict[str, EstimatedBody] = {}
    for joint in without:
        links = [
            frame.name
            for frame in model.frames
            if frame.type == pin.FrameType.BODY and frame.parentJoint == joint
        ]
        own = {name: body for name in links if (body := _body_of_shapes(name, shapes)) is not None}
        if not own:
            link = first_link_of(model, joint)
            if not radii[joint - 1] > 0.0:
                raise RobotError(
                    f"{urdf}: the mass of link {link!r} cannot be estimated: it has no <inertial>"
                    " of its own and no shape, and an arm whose joints all lie at one point has no"
                    " length."
                    " Give the link an <inertial>, or a shape, or write [[link]] with its mass,"
                    " com and inertia into a robot file of your own."
                )
            rod = rods.get(joint)
            begin, end = (np.zeros(3), np.zeros(3)) if rod is None else (rod.begin, rod.end)
            own = {link: _body_of_rod(begin, end, radii[joint - 1])}
        found |= own
    return found


def fit_to_torque_limits(
    bodies: Mapping[str, EstimatedBody], weight: np.ndarray, torques: np.ndarray
) -> dict[str, EstimatedBody]:
    """Scale estimated bodies to the gravity torque that the drives usually hold.

    Rods are scaled half way (by logarithms). Shapes are more reliable: they are scaled, and then
    fully, only where the drives could not hold them, since shapes may be safety envelopes. `weight`
    (n,) is the largest gravity torque of each joint by these bodies, `torques` its limits, NaN
    where there is no plausible one [N m].
    """
    carrier = int(np.argmax(weight))
    if not (weight[carrier] > 0.0 and np.isfinite(torques[carrier])):
        return dict(bodies)
    strength = float(torques[carrier] / weight[carrier])
    usual = strength / _USUAL_TORQUE_RATIO
    rods = float(np.clip(np.sqrt(usual), 1.0 / _MAX_MASS_FACTOR, _MAX_MASS_FACTOR))
    shapes = 1.0
    if strength < _MIN_TORQUE_RATIO:
        shapes, rods = usual, min(rods, strength / _MIN_TORQUE_RATIO)
    return {
        name: _scale_body(body, shapes if body.shaped else rods) for name, body in bodies.items()
    }


def _scale_body(body: EstimatedBody, scale: float) -> EstimatedBody:
    if scale == 1.0:
        return body
    return replace(body, mass=scale * body.mass, inertia=scale * body.inertia, scale=scale)


def _body_of_shapes(link: str, shapes: tuple[LinkShape, ...]) -> EstimatedBody | None:
    """Body of a link by its collision shapes, else its visual ones; None without any."""
    for purpose in ("collision", "visual"):
        parts = [
            part
            for s in shapes
            if s.link == link and s.purpose == purpose
            for part in _shape_masses(s)
        ]
        if parts:
            return _combine_masses(parts)
    return None


def _shape_masses(shape: LinkShape) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    form: Any = coal_form(shape)
    if form is not None and 0.0 < form.computeVolume() < _MAX_LINK_VOLUME:
        yield _mass_in_link(form, DENSITY, shape.rotation, shape.offset)


def _mass_in_link(
    form: Any, density: float, rotation: np.ndarray, offset: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre (3,) and inertia about the centre (3, 3) in the frame of the link."""
    mass = density * float(form.computeVolume())
    centre = rotation @ np.array(form.computeCOM()) + offset
    inertia = density * np.array(form.computeMomentofInertiaRelatedToCOM())
    return mass, centre, rotation @ inertia @ rotation.T


def _body_of_rod(begin: np.ndarray, end: np.ndarray, radius: float) -> EstimatedBody:
    """Body of a capsule and a housing at its start; of the housing alone without length."""
    length = float(np.linalg.norm(end - begin))
    up = np.array([0.0, 0.0, 1.0])
    housing = _mass_in_link(
        coal.Cylinder(radius, _HOUSING_RADII * radius), ROD_DENSITY, np.eye(3), begin
    )
    if length == 0.0:
        return _combine_masses([housing], shaped=False)
    turn = pin.Quaternion.FromTwoVectors(up, (end - begin) / length).matrix()
    middle = 0.5 * (begin + end)
    rod = _mass_in_link(coal.Capsule(radius, length), ROD_DENSITY, turn, middle)
    return _combine_masses([housing, rod], shaped=False)


def _combine_masses(
    parts: list[tuple[float, np.ndarray, np.ndarray]], *, shaped: bool = True
) -> EstimatedBody:
    mass = sum(part[0] for part in parts)
    com = np.sum([part[0] * part[1] for part in parts], axis=0) / mass
    inertia = np.zeros((3, 3))
    for own, centre, tensor in parts:
        arm = centre - com
        inertia += tensor + own * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return EstimatedBody(mass=float(mass), com=com, inertia=inertia, shaped=shaped)
