"""Physics of a loop beyond rigid bodies, friction and rotors; factors of its matrices."""

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


def factorize(matrix: ca.SX, *, symmetric: bool) -> list[list[ca.SX]]:
    """Return triangular factors of a matrix (n, n) in one, which share their diagonal.

    Without pivots: masses outweigh what torques by accelerations add.
    """
    n = matrix.shape[0]
    factor: list[list[ca.SX]] = [[ca.SX(0)] * n for _ in range(n)]
    for i in range(n):
        for j in range(i):
            for row, column in ((i, j), (j, i)):
                rest = matrix[row, column]
                rest -= sum(factor[row][k] * factor[k][column] for k in range(j))
                factor[row][column] = rest / factor[j][j]
                if symmetric:
                    factor[j][i] = factor[i][j]
                    break
        rest = matrix[i, i] - sum(factor[i][k] * factor[k][i] for k in range(i))
        factor[i][i] = ca.sqrt(rest)
    return factor


def solve(factor: list[list[ca.SX]], right: ca.SX) -> ca.SX:
    """Solve with the factors of a matrix; `right` (n, m)."""
    n = len(factor)
    forward: list[ca.SX] = []
    for i in range(n):
        rest = right[i, :] - sum(factor[i][k] * forward[k] for k in range(i))
        forward.append(rest / factor[i][i])
    found: list[ca.SX] = [ca.SX(0)] * n
    for i in reversed(range(n)):
        rest = forward[i] - sum(factor[i][k] * found[k] for k in range(i + 1, n))
        found[i] = rest / factor[i][i]
    return ca.vertcat(*found)
