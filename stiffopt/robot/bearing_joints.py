"""Robot whose elastic output bearings are joints of their own, on linear springs.

Each component of a bearing with a stiffness is one joint without a motor, after the driven joint:
radial and axial displacement, then both tilts. Everything that holds for joints holds for them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.joint_load import complete_axes

if TYPE_CHECKING:
    from stiffopt.drivetrain.bearing import OutputBearing
    from stiffopt.drivetrain.chain import Chain
    from stiffopt.robot.robot import Robot

# Of joints without a motor.
_UNDRIVEN_JOINT_VALUES = {
    "torque_max": np.inf,
    "position_lower": -np.inf,
    "position_upper": np.inf,
    "velocity_max": np.inf,
    "acceleration_max": np.inf,
    "jerk_max": np.inf,
    "rotor_inertia": 0.0,
    "coulomb": 0.0,
    "viscous": 0.0,
    "damping": np.nan,
    "hysteresis": 0.0,
}


def with_bearing_joints(robot: Robot) -> tuple[Robot, np.ndarray]:
    """Return the robot with a joint for each component of its bearings, and their stiffness (m,).

    The stiffness of driven joints, which have their drivetrains, is 0 [N m/rad or N/m].

    Parameters
    ----------
    robot : Robot
    """
    model = pin.Model()
    springs: list[float] = []
    chains: list[Chain | None] = []
    model.gravity, model.name = robot.model.gravity, robot.name
    # Last joint of each body, and the body's frame on it.
    ends = {0: (0, pin.SE3.Identity())}
    for i, body in enumerate(robot.tree.bodies, start=1):
        before, frame = ends[body.parent]
        kind = (
            pin.JointModelPrismaticUnaligned if body.prismatic else pin.JointModelRevoluteUnaligned
        )
        at = frame * pin.SE3(body.rotation, body.translation)
        last = model.addJoint(before, kind(body.axis), at, body.name)
        springs.append(0.0)
        chains.append(robot.chains[i - 1])
        bearing, axes = robot.bearings[i - 1], complete_axes(body.axis)
        here, frame = pin.SE3(axes, np.zeros(3)), pin.SE3.Identity()
        if bearing is not None:
            here.translation = bearing.position * axes[:, 2]
            frame = here.inverse()
            for name, joint, spring in _components(bearing):
                last = model.addJoint(last, joint, here, f"bearing of {body.name}, {name}")
                springs.append(spring)
                chains.append(None)
                here = pin.SE3.Identity()
        ends[i] = (last, frame)
        model.appendBodyToJoint(last, robot.model.inertias[i], frame)

    def move_frame(link: LinkFrame) -> LinkFrame:
        joint, frame = ends[link.joint]
        found = frame * pin.SE3(link.rotation, link.offset)
        return replace(link, joint=joint, offset=found.translation, rotation=found.rotation)

    stiffness = np.array(springs)
    arrays: dict[str, Any] = {
        key: np.full(model.nv, value) for key, value in _UNDRIVEN_JOINT_VALUES.items()
    }
    for key, values in arrays.items():
        own = getattr(robot, key)
        if own is not None:
            values[stiffness == 0.0] = own
    found = replace(
        robot,
        model=model,
        chains=tuple(chains),
        bearings=(),
        shapes=(),
        tool=move_frame(robot.tool),
        flange=move_frame(robot.flange),
        **arrays,
    )
    return found, stiffness


def _components(bearing: OutputBearing) -> Iterator[tuple[str, object, float]]:
    """Name, joint and stiffness of the components that yield."""
    for name, joint, stiffness in (
        ("radial x", pin.JointModelPX(), bearing.radial_stiffness),
        ("radial y", pin.JointModelPY(), bearing.radial_stiffness),
        ("axial", pin.JointModelPZ(), bearing.axial_stiffness),
        ("tilt x", pin.JointModelRX(), bearing.moment_stiffness),
        ("tilt y", pin.JointModelRY(), bearing.moment_stiffness),
    ):
        if stiffness is not None:
            yield name, joint, stiffness
