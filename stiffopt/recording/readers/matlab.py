"""Run files of MATLAB: arrays and structures by name, of version 5 and 7.3."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.columns import Table, columns_of_arrays

# Signature of HDF5, which version 7.3 is, behind a header of 512 bytes.
_HDF5_SIGNATURE, _HEADER_BYTES = b"\x89HDF\r\n\x1a\n", 512


def read_tables(path: Path) -> dict[str, Table]:
    """Read the table of a .mat file."""
    with path.open("rb") as stream:
        head = stream.read(_HEADER_BYTES + len(_HDF5_SIGNATURE))
    if _HDF5_SIGNATURE in (head[:8], head[_HEADER_BYTES:]):
        return {"": _read_version_7_3(path)}
    content = loadmat(path, simplify_cells=True)
    leaves = dict(_flatten_variables(content, path))
    return {"": columns_of_arrays(leaves)}


def _flatten_variables(content: Mapping[str, Any], path: Path) -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if name.startswith("__"):
            if name == "__function_workspace__":
                raise _opaque_objects(path)
            continue
        yield from _flatten_structure(value, name)


def _flatten_structure(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield arrays of nested structures; those with a label or a name, as Simulink's, under it."""
    if isinstance(value, Mapping):
        label = next(
            (own for key in ("label", "name") if isinstance(own := value.get(key), str)), ""
        )
        for key, own in value.items():
            yield from _flatten_structure(own, f"{name}.{label or key}" if key == "values"
                                          else f"{name}.{key}")  # fmt: skip
    elif isinstance(value, list | np.ndarray) and len(np.shape(value)) and _holds_mappings(value):
        for k, own in enumerate(value):
            yield from _flatten_structure(own, f"{name}[{k}]")
    else:
        yield name, value


def _holds_mappings(value: Any) -> bool:
    return len(value) > 0 and isinstance(value[0], Mapping)


def _opaque_objects(path: Path) -> InputFileError:
    return InputFileError(
        path, "", "holds objects of MATLAB (timeseries, table, string), which only MATLAB reads."
        " Save arrays in it: q = ts.Data; t = ts.Time; save('log.mat', 't', 'q', 'tau')."
    )  # fmt: skip


def _read_version_7_3(path: Path) -> Table:
    import h5py

    from stiffopt.recording.readers.hdf5 import read_arrays

    with h5py.File(path, "r") as file:
        variables = {name: own for name, own in file.items() if not name.startswith("#")}
        if any("MATLAB_object_decode" in own.attrs for own in variables.values()):
            raise _opaque_objects(path)
        return columns_of_arrays(read_arrays(file, path))
