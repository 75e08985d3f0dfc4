"""Elastic modes of an arm: frequencies, damping ratios and shapes, in poses or along a motion.

Linearised at rest: springs at their tangent stiffness, weight with its derivative by the pose,
motors held. Damping ratios neglect the coupling of the modes by damping.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy

from stiffopt.elastic.arm import ElasticArm, rigid_arm_error
from stiffopt.errors import NotSimulatedError
from stiffopt.files import write_csv

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot


_MIN_NAMED_SHARE = 0.1  # of the energy; joints below it are not named
_DIFFERENCE_STEP = 1e-6  # of central differences of the weight [rad]
# Smallest over largest eigenvalue of the inertia matrix; below it, it is singular.
_MIN_INERTIA_RATIO = 1e-13


@dataclass(frozen=True)
class Mode:
    """One mode of the arm."""

    frequency: float  # undamped natural frequency [Hz]
    damping: float  # damping ratio
    shares: np.ndarray  # (n,) share of each joint's spring in the strain energy; they sum to 1
    shape: np.ndarray  # (n,) motion of the joints, of unit modal mass
    tool: np.ndarray  # (3,) displacement of the tool in it [m]

    def describe(self) -> str:
        """Describe the joints that take part: "joint 1 (92 % of the energy)"."""
        order = [int(j) for j in np.argsort(-self.shares) if self.shares[j] >= _MIN_NAMED_SHARE]
        sizes = [f"{100.0 * self.shares[j]:.0f} %" for j in order]
        sides = np.sign(self.shape[order]) == np.sign(self.shape[order[0]])
        text = f"joint {order[0] + 1} ({sizes[0]} of the energy)"
        for j, size, together in zip(order[1:], sizes[1:], sides[1:], strict=True):
            text += f" {'with' if together else 'against'} joint {j + 1} ({size})"
        return text


def modes(arm: ElasticArm, motor: np.ndarray) -> tuple[Mode, ...]:
    """Modes at rest with the motors at `motor` (n,) [rad], lowest first; none for a rigid arm.

    Raises `NotSimulatedError`: the springs do not hold the arm in this pose.
    """
    free = np.flatnonzero(arm.elastic)
    if not free.size:
        return ()
    q = arm.static_equilibrium(np.asarray(motor, dtype=float)[None])[0]
    springs = arm.stiffness(arm.static_torque(q))[free]
    slopes = np.empty((arm.robot.n, free.size))
    for column, j in enumerate(free):
        step = np.zeros(arm.robot.n)
        step[j] = _DIFFERENCE_STEP
        slopes[:, column] = (arm.static_torque(q + step) - arm.static_torque(q - step)) / (
            2 * _DIFFERENCE_STEP
        )
    weight = slopes[free]
    stiffness = np.diag(springs) + 0.5 * (weight + weight.T)
    inertia = arm.bodies.inertia_matrix(q)[np.ix_(free, free)]
    _check_inertia(arm, free, inertia)
    squares, shapes = scipy.linalg.eigh(stiffness, inertia)
    if not squares[0] > 0.0:
        raise NotSimulatedError("the springs do not hold the arm in this pose: it falls over.")
    jacobian = arm.bodies.jacobian(arm.robot.tool, q)[:3]
    found = []
    for square, column in zip(squares, shapes.T, strict=True):
        shape = np.zeros(arm.robot.n)
        shape[free] = column
        energy = np.zeros(arm.robot.n)
        energy[free] = springs * column**2
        rate = float(np.sqrt(square))
        found.append(
            Mode(
                frequency=rate / (2.0 * np.pi),
                damping=float(arm.damping[free] @ column**2 / (2.0 * rate)),
                shares=energy / energy.sum(),
                shape=shape,
                tool=jacobian @ shape,
            )
        )
    return tuple(found)


def _check_inertia(arm: ElasticArm, free: np.ndarray, inertia: np.ndarray) -> None:
    sizes, ways = np.linalg.eigh(inertia)
    if sizes[0] <= _MIN_INERTIA_RATIO * max(sizes[-1], 0.0):
        name = arm.robot.joint_names[int(free[np.argmax(np.abs(ways[:, 0]))])]
        raise NotSimulatedError(
            f"the links behind {name} have no inertia about it, so its spring has no vibration."
            " Give their masses and inertias ([[link]] of the robot file, or the URDF), or leave"
            " the drivetrain of that joint out (rigid)."
        )


_INSTANTS_ALONG_MOTION = 61


@dataclass(frozen=True, kw_only=True)
class PoseModes:
    """Modes in one pose."""

    name: str
    time: float  # along a motion [s]; 0 where there is none
    modes: tuple[Mode, ...]  # the lowest first
    # Joints (from 1) whose damping is assumed, from the first pose on.
    assumed_damping: tuple[int, ...]


def modes_at(robot: Robot, poses: Mapping[str, np.ndarray]) -> list[PoseModes]:
    """Modes in named poses, joint angles (n,) [rad] each."""
    arm = _make_elastic_arm(robot, next(iter(poses.values())))
    return [
        PoseModes(
            name=name,
            time=0.0,
            modes=modes(arm, angles),
            assumed_damping=arm.assumed_damping,
        )
        for name, angles in poses.items()
    ]


def modes_along(robot: Robot, time: np.ndarray, position: np.ndarray) -> list[PoseModes]:
    """Modes at 61 poses along a motion (K,) [s], (K, n) [rad], linearised at rest."""
    arm = _make_elastic_arm(robot, position[0])
    instants = np.linspace(time[0], time[-1], _INSTANTS_ALONG_MOTION)
    return [
        PoseModes(
            name=f"at {instant:.3f} s",
            time=float(instant),
            modes=modes(arm, np.array([np.interp(instant, time, joint) for joint in position.T])),
            assumed_damping=arm.assumed_damping,
        )
        for instant in instants
    ]


def write_modes_csv(rows: Sequence[PoseModes], path: Path) -> None:
    """Write frequency [Hz] and damping ratio of every mode over time [s]."""
    numbers = range(1, len(rows[0].modes) + 1)
    names = ["t", *(f"f{k}" for k in numbers), *(f"damping{k}" for k in numbers)]
    write_csv(
        path,
        names,
        [
            [row.time, *(m.frequency for m in row.modes), *(m.damping for m in row.modes)]
            for row in rows
        ],
    )


def _make_elastic_arm(robot: Robot, at: np.ndarray) -> ElasticArm:
    arm = ElasticArm(robot, at)
    if not arm.elastic.any():
        raise rigid_arm_error(robot)
    return arm
