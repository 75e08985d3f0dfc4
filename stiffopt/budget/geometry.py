"""Errors of the tool by geometry: base, frames and zeros of the joints, tool, thermal growth."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stiffopt.budget.sources import ErrorSource, ToolJacobians, rigid_shifts
from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.tolerances import TOLERANCE_IN_STANDARD_DEVIATIONS, Tolerances


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
