"""Tables of motions: arrays over time as numbered columns of a CSV file, written and read.

An array (K,) is one column, such as "t"; (K, n) are "q1", "q2", ... of "q"; a name that ends in "_"
is that of a vector (K, 3), "tool_x", "tool_y" and "tool_z" of "tool_".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.files import read_table, write_csv


def column_names(name: str, count: int) -> list[str]:
    """Return the columns of an array with `count` joints."""
    return [f"{name}{end}" for end in ("xyz" if name.endswith("_") else range(1, count + 1))]


def motion_columns(arrays: Mapping[str, np.ndarray | None]) -> dict[str, np.ndarray]:
    """Return the columns (K,) of arrays by their names; None has none."""
    table: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        if values is not None and values.ndim == 1:
            table[name] = values
        elif values is not None:
            table |= zip(column_names(name, values.shape[1]), values.T, strict=True)
    return table


def write_motion_table(path: Path, arrays: Mapping[str, np.ndarray | None]) -> None:
    """Write arrays over time as a CSV file."""
    table = motion_columns(arrays)
    write_csv(path, list(table), np.column_stack(list(table.values())).tolist())


def read_motion_table(
    path: Path, joints: int, needed: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """Read "t" (K,) and arrays (K, n) or (K, 3) of a table; `optional` ones where complete.

    Raises `InputFileError`: as of `read_table`, or the motion has more joints.
    """
    names = {name: column_names(name, joints) for name in (*needed, *optional)}
    beyond = [f"{name}{joints + 1}" for name in needed[:1]]
    table = read_table(
        path,
        ["t", *(column for name in needed for column in names[name])],
        [*(column for name in optional for column in names[name]), *beyond],
    )
    for column in set(beyond) & set(table):
        raise InputFileError(
            path,
            column,
            f"the trajectory has more joints than the robot, {joints}. Give the trajectory of this"
            " robot.",
        )
    found = {
        name: np.column_stack([table[column] for column in own])
        for name, own in names.items()
        if all(column in table for column in own)
    }
    return {"t": np.array(table["t"])} | found
