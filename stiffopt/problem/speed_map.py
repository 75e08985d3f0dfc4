"""Velocity limits that depend on the joint's own position, from a CSV file."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import check_file


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
    check_file(path)
    columns = [f"{letter}{j + 1}" for letter in "qv" for j in range(joints)]
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputFileError(path, "", "is not a CSV text file. Save it as one.") from error
    if len(rows) < 2 or any(column not in rows[0] for column in columns):
        raise InputFileError(
            path, "", f"needs at least two rows and the columns {', '.join(columns)}."
        )
    table = np.array(
        [[_number(path, k, c, row[c]) for c in columns] for k, row in enumerate(rows, start=1)]
    )
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


def _number(path: Path, row: int, column: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputFileError(
            path, f"row {row}, {column}", f"needs a finite number, got {text or ''!r}."
        )
    return value
