"""Elastic bearings and bending links of a robot: their deflection, and joints that stand for them.

Each component with a stiffness is one joint without a motor, after the driven joint: three
displacements, then three rotations, on linear springs. What holds for joints holds for them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.joint_load import complete_axes, joint_frames, joint_wrenches, supports_tool

if TYPE_CHECKING:
    from stiffopt.drivetrain.chain import Chain
    from stiffopt.robot.robot import Robot

# Displacement that counts as much as a rotation of 1 rad, where joints cannot correct both [m].
_ROTATION_LENGTH = 1e-2
# Damping of the correction near singular poses: lever arm with which a joint hardly moves the tool
# [m/rad], a tenth of the rotation's length.
_MIN_LEVER_ARM = 1e-3


def bearing_deflections(
    robot: Robot,
    position: np.ndarray,
    velocity: np.ndarray | None = None,
    acceleration: np.ndarray | None = None,
    force: np.ndarray | None = None,
) -> np.ndarray:
    """Displacement [m] and rotation [rad] of the tool by each joint's bearing and link.

    (K, n, 6) in base axes, at positions (K, n) of the links; default at rest and without a force ON
    the tool [N].
    """
    found = np.zeros((*position.shape, 6))
    if not robot.tilts:
        return found
    still = np.zeros_like(position)
    velocity, acceleration = (still if x is None else x for x in (velocity, acceleration))
    force = np.zeros(3) if force is None else np.atleast_2d(force)[:, None]
    wrench = joint_wrenches(robot, position, velocity, acceleration, force)
    axes, arm = joint_frames(robot, position)
    carrying = supports_tool(robot)
    for j, mount in ((k, each) for k, mounts in enumerate(robot.mounts) for each in mounts):
        loads = mount.loads(j)
        if not carrying[loads[-1]]:
            continue
        lever, load = arm[:, j] - axes[:, j] @ mount.place, np.zeros((len(position), 2, 3))
        for source in loads:
            own = wrench[:, source].reshape(-1, 2, 3) @ axes[:, source].swapaxes(1, 2)
            own[:, 1] += np.cross(lever - arm[:, source], own[:, 0])
            load += own / len(loads)
        own = axes[:, j] @ mount.axes
        away = -(load @ own * mount.compliance.reshape(2, 3)) @ own.swapaxes(1, 2)
        moved, turned = away[:, 0], away[:, 1]
        found[:, j] += np.concatenate([moved + np.cross(turned, lever), turned], axis=1)
    return found


def dynamic_bearing_deflections(
    robot: Robot,
    position: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    force: np.ndarray | None = None,
    path_force: np.ndarray | None = None,
) -> np.ndarray:
    """Deflections (K, n, 6) of a motion less those at rest in the same poses under `force`."""
    pressed = force if path_force is None else path_force + (0.0 if force is None else force)
    moving = bearing_deflections(robot, position, velocity, acceleration, pressed)
    return np.asarray(moving - bearing_deflections(robot, position, force=force))


def correcting_joints(robot: Robot, position: np.ndarray, deflection: np.ndarray) -> np.ndarray:
    """Changes (K, n) of the joints that move the tool against deflections (K, 6).

    Displacements come before rotations where there are fewer than six joints.
    """
    weight = np.repeat([1.0, _ROTATION_LENGTH], 3)
    bodies = robot.rigid_bodies()
    jacobian = weight[:, None] * np.array([bodies.jacobian(robot.tool, q) for q in position])
    across = jacobian.swapaxes(1, 2)
    left = jacobian @ across + _MIN_LEVER_ARM**2 * np.eye(6)
    return np.asarray(-(across @ np.linalg.solve(left, (weight * deflection)[..., None]))[..., 0])


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
