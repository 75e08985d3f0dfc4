"""Sources of tool error: the effect of each by one standard deviation, in every state.

Those of geometry are base, frames and zeros of the joints, tool, and thermal growth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.robot import Robot
from stiffopt.robot.tolerances import TOLERANCE_IN_STANDARD_DEVIATIONS, Tolerances

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


def geometric_sources(tool: ToolJacobians, tolerances: Tolerances) -> Iterator[ErrorSource]:
    """Yield the sources of geometry, and of thermal growth.

    Frames of joints that do not move the tool have none.
    """
    robot, count = tool.robot, len(tool.place)
    size = {
        key: value / TOLERANCE_IN_STANDARD_DEVIATIONS
        for key, value in vars(tolerances).items()
        if isinstance(value, float)
    }
    base = np.broadcast_to(np.eye(3), (count, 3, 3))
    yield from rigid_shifts(
        "base", "geometry", base, tool.place, (size["base_position"], size["base_orientation"])
    )
    bodies = robot.rigid_bodies()
    for joint, body in enumerate(robot.tree.bodies, start=1):
        if not np.any(tool.jacobian[:, :, joint - 1]):
            continue
        # The placement on the link before, which the joint's own position does not turn.
        held = LinkFrame(body.parent, body.translation, body.rotation)
        if body.parent:
            poses = [bodies.pose(held, q) for q in tool.position]
            origin = np.array([place for place, _ in poses])
            axes = np.array([rotation for _, rotation in poses])
        else:
            origin = np.broadcast_to(body.translation, (count, 3))
            axes = np.broadcast_to(body.rotation, (count, 3, 3))
        sizes = (size["frame_position"], size["frame_orientation"])
        yield from rigid_shifts(
            f"frame of {body.name}", "geometry", axes, tool.place - origin, sizes
        )
        zero = size["frame_position"] if body.prismatic else size["joint_zero"]
        if zero > 0.0:
            yield ErrorSource(
                name=f"zero of {body.name}",
                group="geometry",
                effect=zero * tool.jacobian[:, :, joint - 1],
            )
    yield from rigid_shifts(
        "tool",
        "geometry",
        tool.axes,
        np.zeros((count, 3)),
        (size["tool_position"], size["tool_orientation"]),
    )
    if size["thermal_growth"] > 0.0:
        grown = np.concatenate([size["thermal_growth"] * tool.place, np.zeros((count, 3))], axis=1)
        yield ErrorSource(name="temperature", group="thermal growth", effect=grown)
