"""Physics of a loop beyond rigid bodies, friction and rotors: torques, displacements, springs."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Amplitudes:
    """Unknown values (m,) of a loop's physics, parameters of its fit."""

    names: tuple[tuple[Hashable, int], ...] = ()  # key of the cause, and number
    symbols: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))  # to begin with
    deviations: np.ndarray = field(default_factory=lambda: np.zeros(0))  # before the fit
    bounds: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))  # (m, 2)


@dataclass(frozen=True, kw_only=True)
class LoopPhysics:
    """Physics of a loop beyond rigid bodies, friction and rotors; formulas of its amplitudes."""

    # Torques (n,) that the drives have to give besides; affine in accelerations.
    torque: Callable[[LoopSignals], ca.SX] | None = None
    # Readings (n,) -> motor less link angles (n,) of rigid joints [rad].
    displacement: Callable[[ca.SX], ca.SX] | None = None
    springs: Mapping[int, LoopSpring] = field(default_factory=dict)  # of elastic joints (from 0)
    limits: Mapping[int, ca.SX] = field(default_factory=dict)  # largest torques of actuators [N m]
    # Shares of viscous friction that such actuators give themselves, within their limit.
    damped: Mapping[int, ca.SX] = field(default_factory=dict)
    amplitudes: Amplitudes = field(default_factory=Amplitudes)
