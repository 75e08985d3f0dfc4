"""Run files of HDF5: datasets by path, one run a group where groups repeat (robomimic)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.checks import check_numbers
from stiffopt.recording.readers.columns import MAX_ENTRIES, Table, columns_of_arrays


def read_tables(path: Path) -> dict[str, Table]:
    """Read the tables of a file by run: "demo_0" of robomimic, "" where there is only one."""
    with h5py.File(path, "r") as file:
        groups = _find_runs(file)
        return {name: columns_of_arrays(read_arrays(group, path)) for name, group in groups.items()}


def _find_runs(group: Any) -> dict[str, Any]:
    """Return the groups of the runs: groups beside each other that hold the same datasets."""
    inner = {name: own for name, own in group.items() if isinstance(own, h5py.Group)}
    datasets = any(isinstance(own, h5py.Dataset) for own in group.values())
    if datasets or not inner:
        return {"": group}
    if len(inner) == 1:
        return _find_runs(next(iter(inner.values())))
    held = [frozenset(_dataset_names(own)) for own in inner.values()]
    return inner if len(set(held)) == 1 else {"": group}


def _dataset_names(group: Any) -> list[str]:
    names: list[str] = []
    group.visititems(
        lambda name, own: names.append(name) if isinstance(own, h5py.Dataset) else None
    )
    return names


def read_arrays(group: Any, path: Path) -> dict[str, np.ndarray]:
    """Read the numeric datasets of a group that may be signals, by dotted path."""
    arrays: dict[str, np.ndarray] = {}

    def visit(name: str, own: Any) -> None:
        if not isinstance(own, h5py.Dataset) or own.dtype.kind not in "fiub":
            return
        if own.ndim not in (1, 2) or (own.ndim == 2 and min(own.shape) > MAX_ENTRIES):
            return
        check_numbers(path, own.size + sum(each.size for each in arrays.values()), 1)
        arrays[name.replace("/", ".")] = np.asarray(own[()])

    for name, own in group.items():
        # MATLAB files of version 7.3 store cells under "#refs#".
        if not name.startswith("#"):
            visit(name, own)
            if isinstance(own, h5py.Group):
                own.visititems(lambda inner, each, outer=name: visit(f"{outer}/{inner}", each))
    if not arrays:
        raise InputFileError(path, "", "holds no datasets of numbers with one or two axes.")
    return arrays
