"""Sources of tool error: the effect of each by one standard deviation, in every state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from stiffopt.robot.robot import Robot

Group = Literal["geometry", "torsion", "tilt", "payload", "hysteresis", "servo", "thermal growth"]
GROUPS: tuple[Group, ...] = (
    "geometry",
    "torsion",
    "tilt",
    "payload",
    "hysteresis",
    "servo",
    "thermal growth",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorSource:
    """One independent cause of error, normally distributed."""

    name: str  # of the quantity: "frame of joint_2, position"
    group: Group
    # (K, 6) displacement [m] and rotation [rad] of the tool by one standard deviation, base axes.
    effect: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownError:
    """Mean error of a group (K, 6), displacement [m] and rotation [rad] of the tool."""

    group: Group
    effect: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class States:
    """States of an arm, along a motion or at rest."""

    time: np.ndarray  # (K,) [s]; zeros at rest
    # (K, n) of the joints [rad], [rad/s], [rad/s^2].
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    lag: np.ndarray  # (K, n) motor position less command with the worst servo [rad]

    @classmethod
    def at_rest(cls, position: np.ndarray) -> States:
        """Make states at rest in poses (K, n)."""
        still = np.zeros_like(position)
        return cls(
            time=np.zeros(len(position)),
            position=position,
            velocity=still,
            acceleration=still,
            lag=still,
        )


@dataclass(frozen=True, eq=False)
class ToolJacobians:
    """Poses and Jacobians of the tool in K states."""

    robot: Robot
    position: np.ndarray  # (K, n) of the joints
    place: np.ndarray = field(init=False)  # (K, 3) tool in the base [m]
    axes: np.ndarray = field(init=False)  # (K, 3, 3) of the tool, as columns
    jacobian: np.ndarray = field(init=False)  # (K, 6, n) of displacement and rotation, base axes

    def __post_init__(self) -> None:
        bodies, tool = self.robot.rigid_bodies(), self.robot.tool
        poses = [bodies.pose(tool, q) for q in self.position]
        jacobians = [bodies.jacobian(tool, q) for q in self.position]
        found = (
            np.array([place for place, _ in poses]),
            np.array([axes for _, axes in poses]),
            np.array(jacobians),
        )
        for name, array in zip(("place", "axes", "jacobian"), found, strict=True):
            object.__setattr__(self, name, array)

    def moved(self, change: np.ndarray) -> np.ndarray:
        """Return the tool error (K, 6) by a change (K, n) of the joints."""
        return np.asarray(np.einsum("kij,kj->ki", self.jacobian, change))


def rigid_shifts(
    name: str, group: Group, axes: np.ndarray, arm: np.ndarray, sizes: tuple[float, float]
) -> Iterator[ErrorSource]:
    """Yield the sources of a frame: three displacements and three rotations.

    `axes` (K, 3, 3): of the frame, as columns in the base. `arm` (K, 3): from the frame to the tool
    [m]. `sizes` (float, float): standard deviation of each displacement [m] and rotation [rad].
    """
    for kind, size in zip(("position", "orientation"), sizes, strict=True):
        for k in range(3 if size > 0.0 else 0):
            axis = size * axes[:, :, k]
            turning = kind == "orientation"
            effect = np.concatenate(
                [np.cross(axis, arm) if turning else axis, axis if turning else 0.0 * axis], axis=1
            )
            yield ErrorSource(name=f"{name}, {kind}", group=group, effect=effect)
