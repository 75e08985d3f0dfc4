"""Arm of a recording set, reduced to the recorded joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from stiffopt.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedArm:
    """Arm and metadata common to all kinds of recording sets.

    Parameters
    ----------
    path : Path
        TOML file of the set.
    name, title, citation, licence : str
    robot : Robot
        Nominal: the recorded joints in the robot's own order, which need not be that of the set.
    joints : tuple of str (n,)
        In the order of the set.
    locked : tuple of str
        Moving joints that the set does not list; held at zero.
    """

    path: Path
    name: str
    title: str
    citation: str
    licence: str
    robot: Robot
    joints: tuple[str, ...]
    locked: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @cached_property
    def order(self) -> np.ndarray:
        """Index of each joint of the set in the robot, (n,)."""
        return joint_order(self.robot, self.joints)

    @property
    def prismatic(self) -> np.ndarray:
        """Return which joints of the set are prismatic, (n,) of bool."""
        return np.asarray(self.robot.prismatic[self.order])


def joint_order(robot: Robot, joints: Sequence[str]) -> np.ndarray:
    """Index of each of these joints in a robot, (n,)."""
    return np.array([robot.joint_names.index(name) for name in joints])
