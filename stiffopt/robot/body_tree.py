"""Bodies and joints of an arm as plain numbers, and as capsules where no shapes are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from stiffopt.errors import RobotError
from stiffopt.robot.frames import LinkFrame

_REVOLUTE_MODELS = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
_PRISMATIC_MODELS = ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned")
_JOINT_KIND_NAMES = {
    "JointModelFreeFlyer": "floating",
    "JointModelPlanar": "planar",
    "JointModelSpherical": "spherical",
    "JointModelSphericalZYX": "spherical",
    "JointModelTranslation": "translation",
    "JointModelMimic": "mimic",
    "JointModelUniversal": "universal",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Moving body and its joint."""

    name: str  # name of the joint
    parent: int  # number of the parent joint, from 1; 0 is the base
    prismatic: bool  # the joint is prismatic, else revolute
    axis: np.ndarray  # (3,) unit vector of the joint axis in the joint's frame
    # (3, 3) axes of the joint frame at zero position in the parent's joint frame.
    rotation: np.ndarray
    # (3,) origin of the joint frame in the parent's joint frame, at zero position [m].
    translation: np.ndarray
    mass: float  # including everything fixed to the body [kg]
    centre: np.ndarray  # (3,) centre of mass in the joint's frame [m]
    # (3, 3) about the centre of mass, in the axes of the joint's frame [kg m^2].
    inertia: np.ndarray

    @property
    def inertial_parameters(self) -> np.ndarray:
        """Mass, first moment and inertia about the joint's origin (10,), all linear in torque.

        m, m c_x, m c_y, m c_z [kg m], I_xx, I_xy, I_yy, I_xz, I_yz, I_zz [kg m^2].
        """
        c = self.centre
        about = self.inertia + self.mass * (c @ c * np.eye(3) - np.outer(c, c))
        rows, columns = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)
        return np.concatenate([[self.mass], self.mass * c, about[rows, columns]])


@dataclass(frozen=True, eq=False)
class BodyTree:
    """Moving bodies of an arm and gravity."""

    bodies: tuple[Body, ...]  # (n,) body i - 1 belongs to joint i; parents come before children
    gravity: np.ndarray  # (3,) in the base frame [m/s^2]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.bodies)

    @property
    def prismatic(self) -> np.ndarray:
        """Return which joints are prismatic, (n,) of bool."""
        return np.array([body.prismatic for body in self.bodies])


def body_tree(model: pin.Model) -> BodyTree:
    """Read the bodies of a pinocchio model with merged fixed joints.

    Raises `RobotError`: a joint that is neither revolute nor prismatic.
    """
    bodies = []
    for i in range(1, model.njoints):
        prismatic, axis = _joint_axis(model, i)
        placement, inertia = model.jointPlacements[i], model.inertias[i]
        bodies.append(
            Body(
                name=str(model.names[i]),
                parent=int(model.parents[i]),
                prismatic=prismatic,
                axis=axis,
                rotation=np.array(placement.rotation),
                translation=np.array(placement.translation),
                mass=float(inertia.mass),
                centre=np.array(inertia.lever),
                inertia=np.array(inertia.inertia),
            )
        )
    return BodyTree(tuple(bodies), np.array(model.gravity.linear))


def _joint_axis(model: pin.Model, i: int) -> tuple[bool, np.ndarray]:
    """Return whether a joint is prismatic, and its axis."""
    joint = model.joints[i]
    kind = joint.shortname()
    if kind in _REVOLUTE_MODELS or kind in _PRISMATIC_MODELS:
        linear, angular = np.array(joint.createData().S).reshape(2, 3)
        return kind in _PRISMATIC_MODELS, linear if kind in _PRISMATIC_MODELS else angular
    if kind.startswith("JointModelR") and "U" in kind:
        name = "unbounded revolute (two coordinates)"
        step = "Read it as a revolute joint without position limits."
    else:
        name = _JOINT_KIND_NAMES.get(kind, kind.removeprefix("JointModel").lower())
        step = "Fix it, or replace it by revolute and prismatic joints."
    raise RobotError(
        f"joint {model.names[i]!r} is of the kind {name}; allowed are revolute and prismatic "
        f"joints (fixed ones are merged into their links). {step}"
    )


# Radius of the first and of the last link over the reach, estimated for typical arms.
_BASE_RADIUS_SHARE, _TOOL_RADIUS_SHARE = 0.055, 0.028


@dataclass(frozen=True)
class Capsule:
    """Cylinder with hemispherical ends, fixed to a joint's frame."""

    joint: int  # from 1; 0 is the base
    # (3,) in the frame of the joint [m].
    begin: np.ndarray
    end: np.ndarray
    radius: float  # [m]: estimated from the arm's reach


def arm_reach(tree: BodyTree, tool: LinkFrame) -> float:
    """Length of the chain of links from the base to the tool [m]."""
    steps = [np.linalg.norm(body.translation) for body in tree.bodies]
    return float(np.sum(steps) + np.linalg.norm(tool.offset))


def mounting_distance(tree: BodyTree) -> float:
    """Distance of the first joint from the origin where it exceeds every link [m]; else zero.

    It places an arm under a ceiling or on a gantry and is no link of the arm.
    """
    first, *others = (float(np.linalg.norm(body.translation)) for body in tree.bodies)
    return first if others and first > max(others) else 0.0


def link_capsules(tree: BodyTree, tool: LinkFrame) -> list[Capsule]:
    """Capsules from every joint to its child joints and to the tool; none for a mounting."""
    mounted = mounting_distance(tree) > 0.0
    radii = joint_radii(tree, tool)
    rods = [
        Capsule(
            body.parent, np.zeros(3), np.array(body.translation), radii[max(body.parent, 1) - 1]
        )
        for body in tree.bodies
        if not (mounted and body.parent == 0)
    ]
    end = tool.offset
    if np.linalg.norm(end) <= 1e-9:
        # Without a tool point: twice the distance to the centre of mass of the last link.
        end = 2.0 * tree.bodies[tool.joint - 1].centre
    rods.append(Capsule(tool.joint, np.zeros(3), np.array(end), 0.7 * radii[-1]))
    return [rod for rod in rods if np.linalg.norm(rod.end) > 1e-9]


def joint_radii(tree: BodyTree, tool: LinkFrame) -> list[float]:
    """Estimated radius of the link of each joint (n,) [m], decreasing towards the tool."""
    own = arm_reach(tree, tool) - mounting_distance(tree)
    return [float(r) for r in own * np.linspace(_BASE_RADIUS_SHARE, _TOOL_RADIUS_SHARE, tree.n)]


# Least moments of inertia [kg m^2], and as a share of the largest, for rounding; MuJoCo refuses
# moments below 1e-15 kg m^2.
_MIN_MOMENT, _MIN_MOMENT_SHARE = 1e-9, 1e-6


def realisable_inertia(inertia: np.ndarray) -> np.ndarray:
    """Raise an inertia (3, 3) to that of a rigid body with the same largest moment."""
    moments, axes = np.linalg.eigh(inertia)
    raised = realisable_moments(moments)
    return inertia if raised is moments else axes @ np.diag(raised) @ axes.T


def realisable_moments(moments: np.ndarray) -> np.ndarray:
    """Raise ascending principal moments (3,) until the triangle inequality holds."""
    least = max(_MIN_MOMENT, _MIN_MOMENT_SHARE * moments[2])
    if moments[0] >= least and moments[0] + moments[1] >= moments[2]:
        return moments
    raised: np.ndarray = np.maximum(moments, least)
    lacking = float((1.0 + _MIN_MOMENT_SHARE) * raised[2] - raised[0] - raised[1])
    raised[:2] += 0.5 * max(lacking, 0.0)
    return raised
