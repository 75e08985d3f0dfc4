"""Physics of a loop beyond rigid bodies, friction and rotors: torques, displacements, springs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import casadi as ca


@dataclass(frozen=True, eq=False)
class LoopSignals:
    """Motion and torques of all joints, one entry (n,) each, in symbols.

    Readings of the encoders, speeds and accelerations of the motors, smooth direction of motion;
    torques of the actuators, of the springs, and of the drives by the model's own friction and
    rotors.
    """

    position: ca.SX
    velocity: ca.SX
    acceleration: ca.SX
    direction: ca.SX
    torque: ca.SX
    spring: ca.SX
    drive: ca.SX


@dataclass(frozen=True, kw_only=True)
class LoopSpring:
    """Spring of a joint between motor and link."""

    # Spring torque [N m] -> motor less link angle [rad], strictly increasing.
    windup: Callable[[ca.SX], ca.SX]
    damping: float = 0.0  # between motor and link [N m s/rad]
    encoder_at_output: bool = False  # the encoder reads the link; otherwise the motor


@dataclass(frozen=True, kw_only=True)
class LoopPhysics:
    """Physics of a loop beyond rigid bodies, friction and rotors."""

    # Torques (n,) that the drives have to give besides; affine in accelerations.
    torque: Callable[[LoopSignals], ca.SX] | None = None
    # Readings (n,) -> motor less link angles (n,) of rigid joints [rad].
    displacement: Callable[[ca.SX], ca.SX] | None = None
    springs: Mapping[int, LoopSpring] = field(default_factory=dict)  # of elastic joints (from 0)
