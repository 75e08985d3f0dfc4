"""Robot whose elastic output bearings are joints of their own, on linear springs.

Each component of a bearing with a stiffness is one joint without a motor, after the driven joint:
radial and axial displacement, then both tilts. Everything that holds for joints holds for them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin

from stiffopt.connection.constant import Constant
from stiffopt.drivetrain.bearing import OutputBearing
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.joint_load import complete_axes
from stiffopt.robot.robot import Robot

# Of joints without a motor.
_UNDRIVEN = {
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
# Up to which the linear springs of bearings are tabulated [N m or N]; beyond they stay linear.
_TABULATED_LOAD = 1e3


def with_bearing_joints(robot: Robot) -> tuple[Robot, np.ndarray]:
    """Return the robot with a joint for each component of its bearings, and the driven joints (n,).

    Parameters
    ----------
    robot : Robot
    """
    model, chains, driven = pin.Model(), list[Chain | None](), list[int]()
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
        driven.append(last - 1)
        chains.append(robot.chains[i - 1])
        bearing, axes = robot.bearings[i - 1], complete_axes(body.axis)
        here, frame = pin.SE3(axes, np.zeros(3)), pin.SE3.Identity()
        if bearing is not None:
            here.translation = bearing.position * axes[:, 2]
            frame = here.inverse()
            for name, joint, stiffness in _components(bearing):
                last = model.addJoint(last, joint, here, f"bearing of {body.name}, {name}")
                spring = Constant(name=name, torque_max=_TABULATED_LOAD, stiffness=stiffness)
                chains.append(Chain((Stage(spring),)))
                here = pin.SE3.Identity()
        ends[i] = (last, frame)
        model.appendBodyToJoint(last, robot.model.inertias[i], frame)

    def placed(link: LinkFrame) -> LinkFrame:
        joint, frame = ends[link.joint]
        found = frame * pin.SE3(link.rotation, link.offset)
        return replace(link, joint=joint, offset=found.translation, rotation=found.rotation)

    count, places = model.nv, np.array(driven)
    arrays = {"torque_max": np.full(count, _TABULATED_LOAD)}
    arrays |= {key: np.full(count, value) for key, value in _UNDRIVEN.items()}
    for key, values in arrays.items():
        own = getattr(robot, key)
        if own is not None:
            values[places] = own
    found = replace(
        robot,
        model=model,
        chains=tuple(chains),
        bearings=(),
        shapes=(),
        tool=placed(robot.tool),
        flange=placed(robot.flange),
        **arrays,
    )
    return found, places


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
