"""Robot whose elastic bearings and bending links are joints of their own, on linear springs.

Each component with a stiffness is one joint without a motor, after the driven joint: three
displacements, then three rotations. Everything that holds for joints holds for them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.joint_load import complete_axes

if TYPE_CHECKING:
    from stiffopt.drivetrain.chain import Chain
    from stiffopt.robot.robot import Robot

# Components of a mount and their joints.
_COMPONENT_NAMES = (
    "displacement x",
    "displacement y",
    "displacement z",
    "tilt x",
    "tilt y",
    "twist",
)
_COMPONENT_JOINTS = (
    *(pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
    *(pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
)
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
    """Return the robot with a joint for each elastic component, and their stiffness (m,).

    The stiffness of driven joints, which have their drivetrains, is 0 [N m/rad or N/m].
    """
    model = pin.Model()
    springs: list[float] = []
    chains: list[Chain | None] = []
    model.gravity, model.name = robot.model.gravity, robot.name
    # Last joint of each body, and the body's frame on it; the same beyond a bending link.
    ends = {0: (0, pin.SE3.Identity())}
    beyond: dict[int, tuple[int, pin.SE3]] = {}
    for i, (body, mounts) in enumerate(zip(robot.tree.bodies, robot.mounts, strict=True), start=1):
        before, frame = beyond.get(i, ends[body.parent])
        kind = (
            pin.JointModelPrismaticUnaligned if body.prismatic else pin.JointModelRevoluteUnaligned
        )
        at = frame * pin.SE3(body.rotation, body.translation)
        last = model.addJoint(before, kind(body.axis), at, body.name)
        springs.append(0.0)
        chains.append(robot.chains[i - 1])
        axes, frame = complete_axes(body.axis), pin.SE3.Identity()
        mounted = [(last, frame)]
        for number, mount in enumerate(mounts, start=1):
            here = pin.SE3(axes @ mount.axes, axes @ mount.place)
            at, frame = frame * here, here.inverse()
            for name, joint, compliance in zip(
                _COMPONENT_NAMES, _COMPONENT_JOINTS, mount.compliance, strict=True
            ):
                if compliance > 0.0:
                    last = model.addJoint(last, joint(), at, f"{name} of {body.name}, {number}")
                    springs.append(1.0 / float(compliance))
                    chains.append(None)
                    at = pin.SE3.Identity()
            if mount.carries is None:
                mounted = [(last, frame)]
            else:
                # Half of a bending link moves with its outer end.
                mounted.append((last, frame))
                beyond[mount.carries + 1] = (last, frame)
        ends[i], share = mounted[0], 1.0 / len(mounted)
        own = robot.model.inertias[i]
        for joint, at in mounted:
            part = pin.Inertia(share * own.mass, own.lever, share * own.inertia)
            model.appendBodyToJoint(joint, part, at)

    def move_frame(link: LinkFrame) -> LinkFrame:
        joint, frame = ends[link.joint]
        found = frame * pin.SE3(link.rotation, link.offset)
        work = None if link.seen_from is None else move_frame(link.seen_from)
        return replace(
            link, joint=joint, offset=found.translation, rotation=found.rotation, seen_from=work
        )

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
        links=(),
        shapes=(),
        tool=move_frame(robot.tool),
        flange=move_frame(robot.flange),
        **arrays,
    )
    return found, stiffness
