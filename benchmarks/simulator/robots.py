"""The robots that are simulated: geometry, inertia, drives and sensors of the nominal machine.

The numbers are invented but of the size of real machines: strain-wave reducers of catalogue
stiffness, dry friction near a tenth of the rated torque, encoders of 17 to 20 bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Body:
    """One joint and the link it moves."""

    origin: Triple  # of the joint in the link before [m]
    axis: Triple
    mass: float  # [kg]
    com: Triple  # [m]
    inertia: Triple  # about the centre of mass, principal axes along the link's [kg m^2]
    slides: bool = False  # along the axis: metres for radians throughout, newtons for newton metres


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A nominal robot; arrays have one value a joint, at the output side."""

    name: str
    bodies: tuple[Body, ...]
    payload_mass: float
    payload_com: Triple
    tool: Triple
    gear_ratio: np.ndarray
    rotor_inertia: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    torque_max: np.ndarray
    torque_rated: np.ndarray
    joint_damping: np.ndarray
    contact_stiffness: np.ndarray
    connections: tuple[str, ...]
    slopes: np.ndarray  # K1, K2, K3 of the reducers (3, n) [N m/rad]
    corners: np.ndarray  # T1, T2 (2, n) [N m]
    speed_max: np.ndarray
    centre: np.ndarray  # middle of the recorded motions [rad]
    reach: np.ndarray  # half width of the recorded motions [rad]
    torque_noise: np.ndarray
    pole_pairs: int = 4
    velocity_noise: float = 2e-3
    link_noise: float = 1.5e-5
    link_count: float = 6e-6
    motor_bits: int = 17

    @property
    def joints(self) -> int:
        return len(self.bodies)

    @property
    def motor_count(self) -> np.ndarray:
        """One count of the motor encoders, at the output side [rad]."""
        return 2 * np.pi / 2**self.motor_bits / self.gear_ratio

    def urdf(self) -> str:
        """The nominal rigid model as an engineer has it."""
        return _urdf(self)

    def model(self) -> pin.Model:
        return pin.buildModelFromXML(self.urdf())


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:g}" for value in values)


def _inertial(mass: float, com: Triple, inertia: Triple) -> str:
    ixx, iyy, izz = inertia
    return (
        f'<inertial><origin xyz="{_numbers(com)}" rpy="0 0 0"/><mass value="{mass:g}"/>'
        f'<inertia ixx="{ixx:g}" ixy="0" ixz="0" iyy="{iyy:g}" iyz="0" izz="{izz:g}"/></inertial>'
    )


def _urdf(robot: Robot) -> str:
    lines = ['<?xml version="1.0"?>', f'<robot name="{robot.name}">', '<link name="base"/>']
    parent = "base"
    for i, body in enumerate(robot.bodies, start=1):
        kind = "prismatic" if body.slides else "revolute"
        lines.append(
            f'<link name="link{i}">{_inertial(body.mass, body.com, body.inertia)}</link>'
            f'<joint name="joint{i}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="link{i}"/><origin xyz="{_numbers(body.origin)}" rpy="0 0 0"/>'
            f'<axis xyz="{_numbers(body.axis)}"/><limit lower="-3.1" upper="3.1" '
            f'effort="{robot.torque_max[i - 1]:g}" velocity="{robot.speed_max[i - 1]:g}"/></joint>'
        )
        parent = f"link{i}"
    radius = 0.04
    ball = 0.4 * robot.payload_mass * radius**2
    inertial = _inertial(robot.payload_mass, robot.payload_com, (ball, 1.2 * ball, 1.1 * ball))
    lines.append(
        f'<link name="payload">{inertial}</link><joint name="payload_mount" type="fixed">'
        f'<parent link="{parent}"/><child link="payload"/></joint>'
        f'<link name="tool0"/><joint name="tool_mount" type="fixed"><parent link="{parent}"/>'
        f'<child link="tool0"/><origin xyz="{_numbers(robot.tool)}" rpy="0 0 0"/></joint></robot>'
    )
    return "\n".join(lines) + "\n"
