"""The constants of an arm, read from `pin.Model` in frames that keep symbolic graphs small.

Each joint gets a body-fixed *axis frame*: same origin as the joint frame, z along the joint axis.
Then every joint is a turn about or a shift along z, whatever the axis was. The freedom left (the
turn of the axis frame about its own z) is spent so that the constant rotation from one axis frame
to the next is a twist about x alone, as in Denavit-Hartenberg frames; what remains of it becomes a
constant offset of the joint angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stiffopt.errors import RobotError

_CLEAN = 1e-14
_REVOLUTE = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
_PRISMATIC = ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned")
_KINDS = {
    "JointModelFreeFlyer": "floating",
    "JointModelPlanar": "planar",
    "JointModelSpherical": "spherical",
    "JointModelSphericalZYX": "spherical",
    "JointModelTranslation": "translation",
    "JointModelMimic": "mimic",
    "JointModelUniversal": "universal",
}


@dataclass(frozen=True)
class AxisJoint:
    """One joint and the body it carries, in axis frames.

    Parameters
    ----------
    name : str
        As in the model.
    parent : int
        Index of the joint it hangs on; 0 is the base.
    column : int
        Its place in q, v and a.
    prismatic : bool
        Shift along z instead of turn about z.
    rotation : array (3, 3)
        Axis frame at zero angle seen from the parent's axis frame.
    angle_offset : float
        Constant turn about z after `rotation`. [rad]
    translation : array (3,)
        Origin in the parent's axis frame; for a prismatic joint at q = 0. [m]
    mass : float
        Of the body with everything fixed to it. [kg]
    first_moment : array (3,)
        Mass times centre of mass, in the axis frame. [kg m]
    inertia : array (3, 3)
        About the origin of the axis frame. [kg m^2]
    from_joint_frame : array (3, 3)
        Turns vectors of pin's joint frame into the axis frame.
    armature : float
        Rotor inertia stored in the model. [kg m^2] or [kg]
    """

    name: str
    parent: int
    column: int
    prismatic: bool
    rotation: np.ndarray
    angle_offset: float
    translation: np.ndarray
    mass: float
    first_moment: np.ndarray
    inertia: np.ndarray
    from_joint_frame: np.ndarray
    armature: float


def clean(values: np.ndarray) -> np.ndarray:
    """Remove the rounding residue of constants: below 1e-14 to 0, within 1e-14 of +-1 to +-1."""
    values = np.where(np.abs(values) < _CLEAN, 0.0, values)
    near_one = np.abs(np.abs(values) - 1.0) < _CLEAN
    return np.where(near_one, np.sign(values), values)


def axis_joints(model: Any) -> tuple[AxisJoint, ...]:
    """Joints of `model` in pin's order, so that entry i - 1 is pin's joint i.

    Parameters
    ----------
    model : pinocchio.Model
        A tree of revolute and prismatic joints about any axes. Fixed joints are already merged
        into their parent bodies by pin.

    Raises
    ------
    RobotError
        For any other kind of joint.
    """
    base = np.eye(3)
    frames, twists, turns = [base], [base], [0.0]
    has_child = [False] * model.njoints
    for i in range(1, model.njoints):
        parent = int(model.parents[i])
        frame = _frame_along(_axis(model, i))
        rotation = frames[parent].T @ model.jointPlacements[i].rotation @ frame
        before, twist, after = _z_x_z(rotation)
        if parent == 0 or has_child[parent]:
            twist = _about_z(before) @ twist
        else:
            has_child[parent] = True
            frames[parent] = frames[parent] @ _about_z(before)
            turns[parent] += before
        frames.append(frame)
        twists.append(twist)
        turns.append(after)
    return tuple(
        _axis_joint(model, i, frames, twists[i], turns[i]) for i in range(1, model.njoints)
    )


def _axis_joint(
    model: Any, i: int, frames: list[np.ndarray], twist: np.ndarray, turn: float
) -> AxisJoint:
    body = model.inertias[i]
    center = frames[i].T @ body.lever
    inertia = frames[i].T @ body.inertia @ frames[i]
    steiner = body.mass * (center @ center * np.eye(3) - np.outer(center, center))
    prismatic = model.joints[i].shortname() in _PRISMATIC
    parent = int(model.parents[i])
    return AxisJoint(
        name=model.names[i],
        parent=parent,
        column=model.joints[i].idx_v,
        prismatic=prismatic,
        rotation=clean(twist @ _about_z(turn)) if prismatic else clean(twist),
        angle_offset=0.0 if prismatic else _clean_angle(turn),
        translation=clean(frames[parent].T @ model.jointPlacements[i].translation),
        mass=float(body.mass),
        first_moment=clean(body.mass * center),
        inertia=clean(inertia + steiner),
        from_joint_frame=clean(frames[i].T),
        armature=float(model.armature[model.joints[i].idx_v]),
    )


def _axis(model: Any, i: int) -> np.ndarray:
    joint = model.joints[i]
    kind = joint.shortname()
    if kind in _REVOLUTE:
        return np.asarray(joint.createData().S).reshape(6)[3:]
    if kind in _PRISMATIC:
        return np.asarray(joint.createData().S).reshape(6)[:3]
    if kind.startswith("JointModelR") and "U" in kind:
        name = "unbounded revolute (two coordinates)"
        step = "Read it as a revolute joint without position limits."
    else:
        name = _KINDS.get(kind, kind.removeprefix("JointModel").lower())
        step = "Fix it, or replace it by revolute and prismatic joints."
    raise RobotError(
        f"joint {model.names[i]!r} is of the kind {name}; allowed are revolute and prismatic "
        f"joints (fixed ones are merged into their links). {step}"
    )


def _frame_along(axis: np.ndarray) -> np.ndarray:
    """Rotation whose third column is `axis`; a permutation where the axis is x, y or z."""
    z = clean(axis / np.linalg.norm(axis))
    x = np.roll(np.eye(3)[int(np.argmax(np.abs(z)))], 1)
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _about_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _z_x_z(rotation: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Angles a, c and twist X about x with rotation = Rz(a) X Rz(c)."""
    sine = float(np.hypot(rotation[0, 2], rotation[1, 2]))
    before = float(np.arctan2(rotation[0, 2], -rotation[1, 2])) if sine > _CLEAN else 0.0
    twist = _about_x(float(np.arctan2(sine, rotation[2, 2])))
    # From what is left, not from the last row: near-parallel axes leave the first angle uncertain
    # and the second has to make up for it.
    rest = twist.T @ _about_z(before).T @ rotation
    return before, twist, float(np.arctan2(rest[1, 0], rest[0, 0]))


def _clean_angle(angle: float) -> float:
    angle = float(np.arctan2(np.sin(angle), np.cos(angle)))
    return 0.0 if abs(angle) < _CLEAN else angle
