"""Modes of an arm in several poses, or along a motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.elastic.arm import ElasticArm, rigid_arm
from stiffopt.elastic.modes import Mode, modes
from stiffopt.files import write_csv

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

_INSTANTS = 61


@dataclass(frozen=True, kw_only=True)
class PoseModes:
    """Modes in one pose.

    Parameters
    ----------
    name : str
    time : float
        Along a motion [s]; 0 where there is none.
    modes : tuple of Mode
        The lowest first.
    assumed_damping : tuple of int
        Joints (from 1) whose damping is assumed, from the first pose on.
    """

    name: str
    time: float
    modes: tuple[Mode, ...]
    assumed_damping: tuple[int, ...]


def modes_at(robot: Robot, poses: Mapping[str, np.ndarray]) -> list[PoseModes]:
    """Modes in named poses, joint angles (n,) [rad] each."""
    arm = _elastic(robot, next(iter(poses.values())))
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
    """Modes at 61 instants of a motion (K,) [s], (K, n) [rad], as if it stood still there."""
    arm = _elastic(robot, position[0])
    instants = np.linspace(time[0], time[-1], _INSTANTS)
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
    """Frequency [Hz] and damping ratio of every mode over time [s]."""
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


def _elastic(robot: Robot, at: np.ndarray) -> ElasticArm:
    arm = ElasticArm(robot, at)
    if not arm.elastic.any():
        raise rigid_arm(robot)
    return arm
