"""Constants of an arm in frames that keep symbolic graphs small.

Each joint gets a body-fixed *axis frame*: same origin as the joint frame, z along the joint axis.
Then every joint is a turn about or a shift along z, whatever the axis was. The free turn of the
axis frame about its own z is chosen so that the constant rotation from one axis frame to the next
is a twist about x alone, as in Denavit-Hartenberg frames, plus a constant offset of the angle.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from stiffopt.robot.body_tree import Body, BodyTree

# Constants nearer than this to 0 or +-1 are rounded to them: zeros vanish from symbolic graphs.
_ROUND_OFF = 1e-14


@dataclass(frozen=True)
class AxisJoint:
    """One joint and the body it carries, in axis frames."""

    parent: int  # number of the parent joint, from 1; 0 is the base
    prismatic: bool  # shift along z instead of turn about z
    rotation: np.ndarray  # (3, 3) axis frame at zero angle seen from the parent's axis frame
    angle_offset: float  # constant turn about z after `rotation` [rad]
    # (3,) origin in the parent's axis frame; for a prismatic joint at q = 0 [m].
    translation: np.ndarray
    mass: float  # of the body with everything fixed to it [kg]
    first_moment: np.ndarray  # (3,) mass times centre of mass, in the axis frame [kg m]
    inertia: np.ndarray  # (3, 3) about the origin of the axis frame [kg m^2]
    from_joint_frame: np.ndarray  # (3, 3) turns vectors of the joint frame into the axis frame


def clean(values: np.ndarray) -> np.ndarray:
    """Remove the rounding residue of constants: below 1e-14 to 0, within 1e-14 of +-1 to +-1."""
    values = np.where(np.abs(values) < _ROUND_OFF, 0.0, values)
    near_one = np.abs(np.abs(values) - 1.0) < _ROUND_OFF
    return np.where(near_one, np.sign(values), values)


@functools.lru_cache(maxsize=16)
def axis_joints(tree: BodyTree) -> tuple[AxisJoint, ...]:
    """Return the joints of an arm in its own order: entry i - 1 is joint i."""
    frames, twists, turns = _axis_frames(
        tuple((body.parent, body.axis.tobytes(), body.rotation.tobytes()) for body in tree.bodies)
    )
    return tuple(
        _axis_joint(body, frames[i], frames[body.parent], twists[i], turns[i])
        for i, body in enumerate(tree.bodies, start=1)
    )


@functools.lru_cache(maxsize=16)
def _axis_frames(
    joints: tuple[tuple[int, bytes, bytes], ...],
) -> tuple[list[np.ndarray], list[np.ndarray], list[float]]:
    """Return the axis frames of base and joints, the constant twists and the turns about the axes.

    A joint is given as (parent, axis, rotation): arms that differ in their bodies share the cache.
    """
    base = np.eye(3)
    frames, twists, turns = [base], [base], [0.0]
    has_child = [False] * (len(joints) + 1)
    for parent, axis, turned in joints:
        frame = _frame_along(np.frombuffer(axis))
        rotation = frames[parent].T @ np.frombuffer(turned).reshape(3, 3) @ frame
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
    return frames, twists, turns


def _axis_joint(
    body: Body, frame: np.ndarray, before: np.ndarray, twist: np.ndarray, turn: float
) -> AxisJoint:
    center = frame.T @ body.centre
    inertia = frame.T @ body.inertia @ frame
    steiner = body.mass * (center @ center * np.eye(3) - np.outer(center, center))
    return AxisJoint(
        parent=body.parent,
        prismatic=body.prismatic,
        rotation=clean(twist @ _about_z(turn)) if body.prismatic else clean(twist),
        angle_offset=0.0 if body.prismatic else _clean_angle(turn),
        translation=clean(before.T @ body.translation),
        mass=body.mass,
        first_moment=clean(body.mass * center),
        inertia=clean(inertia + steiner),
        from_joint_frame=clean(frame.T),
    )


def _frame_along(axis: np.ndarray) -> np.ndarray:
    """Return a rotation whose third column is `axis`; a permutation for the axes x, y and z."""
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
    """Return angles a, c and twist X about x with rotation = Rz(a) X Rz(c)."""
    sine = float(np.hypot(rotation[0, 2], rotation[1, 2]))
    before = float(np.arctan2(rotation[0, 2], -rotation[1, 2])) if sine > _ROUND_OFF else 0.0
    twist = _about_x(float(np.arctan2(sine, rotation[2, 2])))
    # From the remaining rotation, not from the last row: with nearly parallel axes the first angle
    # is uncertain and the second has to compensate for it.
    rest = twist.T @ _about_z(before).T @ rotation
    return before, twist, float(np.arctan2(rest[1, 0], rest[0, 0]))


def _clean_angle(angle: float) -> float:
    angle = float(np.arctan2(np.sin(angle), np.cos(angle)))
    return 0.0 if abs(angle) < _ROUND_OFF else angle
