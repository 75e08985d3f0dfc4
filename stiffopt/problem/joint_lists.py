"""Lists of a file with one entry per joint, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.robot.elements import locate_errors
from stiffopt.robot.robot import Robot
from stiffopt.units import fit_joint


class JointLists:
    """Convert lists of a file to arrays with one entry per joint; errors name the list."""

    def __init__(self, robot: Robot, path: Path) -> None:
        self.robot, self.path = robot, path
        self.names = robot.joint_names
        self.prismatic = robot.prismatic

    def __call__(self, values: Sequence[float], dimension: str, where: str) -> np.ndarray:
        """Convert a list of this dimension to an array (n,); `where` is its key."""
        if len(values) != len(self.names):
            raise InputFileError(
                self.path,
                where,
                f"needs {len(self.names)} values, one a joint ({', '.join(self.names)}); got "
                f"{len(values)}.",
            )
        numbers = []
        for j, value in enumerate(values):
            with locate_errors(self.path, f"{where}[{j + 1}]"):
                numbers.append(fit_joint(value, bool(self.prismatic[j]), dimension, self.names[j]))
        return np.array(numbers)

    def check_number(self, joint: int, where: str) -> None:
        """Raise `InputFileError` unless the joint number is in 1 to n."""
        if not 1 <= joint <= len(self.names):
            raise InputFileError(
                self.path, where, f"there is no joint {joint}; allowed: 1 to {len(self.names)}."
            )
