"""Rotations, and frames fixed to the links of an arm: tool, flange, named frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from stiffopt.errors import RobotError, nearest


def rotation_from_rpy(rpy: ArrayLike) -> np.ndarray:
    """Rotation (3, 3) from roll, pitch, yaw about the fixed x, y, z axes, as in URDF [rad]."""
    return np.array(pin.rpy.rpyToMatrix(np.asarray(rpy, dtype=float)))


def rpy_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (3,) [rad] of a rotation (3, 3)."""
    return np.array(pin.rpy.matrixToRpy(rotation))


def rotation_about_axis(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation (3, 3) about an axis of unit length (3,) by an angle [rad]."""
    return np.array(pin.exp3(angle * np.asarray(axis, dtype=float)))


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle (3,) [rad] of a rotation (3, 3); the angle is at most pi."""
    return np.array(pin.log3(rotation))


def interpolate_rotation(first: np.ndarray, last: np.ndarray, share: float) -> np.ndarray:
    """Rotation (3, 3) at a share of the way from one to another, about their common axis."""
    return np.array(first @ pin.exp3(share * rotation_vector(first.T @ last)))


@dataclass(frozen=True)
class LinkFrame:
    """A frame fixed to a link."""

    joint: int  # index of the link's joint in the pinocchio model (1 is the first moving joint)
    offset: np.ndarray  # (3,) origin in that joint's frame [m]
    rotation: np.ndarray  # (3, 3) axes of the frame, as columns in the joint's frame
    link: str = ""  # link in whose frame the offset was given
    # Frame that carries the work: poses and Jacobians are relative to it and in its axes; None is
    # the base.
    seen_from: LinkFrame | None = None

    @property
    def in_base(self) -> LinkFrame:
        """The frame relative to the base."""
        return replace(self, seen_from=None)


def link_names(model: pin.Model) -> list[str]:
    """Links of a pinocchio model that have a frame."""
    return [f.name for f in model.frames if f.type == pin.FrameType.BODY and f.name != "universe"]


def moving_link_names(model: pin.Model) -> list[str]:
    """Links with a frame that a joint moves."""
    moving = (f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint > 0)
    return [str(f.name) for f in moving]


def link_frame(
    model: pin.Model, link: str, offset: ArrayLike | None = None, rpy: ArrayLike | None = None
) -> LinkFrame:
    """Frame fixed to a moving link, in the frame of the link's joint.

    Place [m] and roll, pitch, yaw [rad] are in the link's frame, default that frame itself. Raises
    `RobotError` for a link that does not exist or move, or numbers that are no frame.
    """
    if link not in link_names(model):
        raise RobotError(f"no link {link!r}. {nearest(link, link_names(model))}")
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    if frame.parentJoint == 0:
        raise RobotError(f"the link {link!r} does not move. Take one behind the last joint.")
    shift = np.zeros(3) if offset is None else np.asarray(offset, dtype=float)
    angles = np.zeros(3) if rpy is None else np.asarray(rpy, dtype=float)
    if shift.shape != (3,) or angles.shape != (3,) or not np.isfinite([*shift, *angles]).all():
        raise RobotError(
            f"a frame at {link!r} needs 3 finite numbers as offset; got {shift.tolist()}."
        )
    placement = frame.placement * pin.SE3(rotation_from_rpy(angles), shift)
    return _build_frame(frame.parentJoint, placement, link)


def frame_names(model: pin.Model) -> list[str]:
    """Names of the frames of a pinocchio model, of links and joints, without that of the ground."""
    return [frame.name for frame in model.frames if frame.name != "universe"]


def named_frame(model: pin.Model, name: str | None = None) -> LinkFrame:
    """Frame of a pinocchio model by name, that of a link before a joint's; default the last."""
    named = [each for each in model.frames if name in (None, each.name)]
    links = [each for each in named if each.type != pin.FrameType.JOINT]
    frame = (links or named)[-1]
    return _build_frame(frame.parentJoint, frame.placement, str(frame.name))


def first_link_of(model: pin.Model, joint: int) -> str:
    """First link of a joint (from 1); the joint's name where its links have no frame."""
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint == joint:
            return str(frame.name)
    return str(model.names[joint])


def _build_frame(joint: int, placement: pin.SE3, name: str) -> LinkFrame:
    return LinkFrame(int(joint), placement.translation.copy(), placement.rotation.copy(), name)
