"""Rotations: matrix, roll-pitch-yaw and rotation vector."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike


def rotation_from_rpy(rpy: ArrayLike) -> np.ndarray:
    """Rotation (3, 3) from roll, pitch, yaw about the fixed x, y, z axes, as in URDF [rad]."""
    return np.array(pin.rpy.rpyToMatrix(np.asarray(rpy, dtype=float)))


def rpy_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (3,) [rad] of a rotation (3, 3)."""
    return np.array(pin.rpy.matrixToRpy(rotation))


def about_axis(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation (3, 3) about an axis of unit length (3,) by an angle [rad]."""
    return np.array(pin.exp3(angle * np.asarray(axis, dtype=float)))


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle (3,) [rad] of a rotation (3, 3); the angle is at most pi."""
    return np.array(pin.log3(rotation))


def rotation_between(first: np.ndarray, last: np.ndarray, share: float) -> np.ndarray:
    """Rotation (3, 3) a share of the way from one to another, about their common axis."""
    return np.array(first @ pin.exp3(share * rotation_vector(first.T @ last)))
