"""Velocity limits that depend on the joint's own position, from a CSV file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import read_table


def read_speed_map(path: Path, joints: int) -> tuple[np.ndarray, np.ndarray]:
    """Read a table with the columns q1.., v1.., one of each a joint, in SI.

    Parameters
    ----------
    path : Path
    joints : int

    Returns
    -------
    positions, speeds : array (k, joints) [rad], [rad/s]
        Positions increase from row to row; between rows the limit is linear, beyond them constant.

    Raises
    ------
    InputFileError
        With the row (the first below the header is 1) and the column.
    """
    columns = [f"{letter}{j + 1}" for letter in "qv" for j in range(joints)]
    read = read_table(path, columns)
    table = np.column_stack([read[column] for column in columns])
    positions, speeds = table[:, :joints], table[:, joints:]
    for row, j in np.argwhere(np.diff(positions, axis=0) <= 0):
        raise InputFileError(
            path,
            f"row {row + 2}, q{j + 1}",
            f"{positions[row + 1, j]:g} follows {positions[row, j]:g}; positions must increase "
            "from row to row.",
        )
    for row, j in np.argwhere(speeds <= 0):
        raise InputFileError(
            path,
            f"row {row + 1}, v{j + 1}",
            f"a speed limit must be greater than zero, got {speeds[row, j]:g}.",
        )
    return positions, speeds
