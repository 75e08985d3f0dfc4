"""Numeric columns of a Parquet file, and vector entries as in LeRobot datasets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as arrow
import pyarrow.parquet as parquet

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.lerobot import vector_names
from stiffopt.recording.readers.parquet import column_to_numbers

# Longest vector of joint signals; longer ones are other data.
_MAX_VECTOR_LENGTH = 64


def parquet_columns(path: Path) -> dict[str, np.ndarray]:
    """Read numbers and stamps by name; vector entries as "observation.state.elbow".

    Raises
    ------
    InputFileError
        Not a Parquet file.
    """
    found: dict[str, np.ndarray] = {}
    try:
        with parquet.ParquetFile(path) as file:
            for field in file.schema_arrow:
                if _is_vector(field.type):
                    column = file.read(columns=[field.name], use_threads=False).column(0)
                    found |= _vector_entries(path, field.name, column)
                elif _is_number(field.type):
                    column = file.read(columns=[field.name], use_threads=False).column(0)
                    found[field.name] = column_to_numbers(path, field.name, column)
    except (arrow.ArrowException, OSError) as error:
        raise InputFileError(path, "", f"cannot be read as Parquet: {error}") from error
    return found


def _is_number(kind: arrow.DataType) -> bool:
    types = arrow.types
    stamp = types.is_timestamp(kind) or types.is_duration(kind)
    return bool(stamp or types.is_integer(kind) or types.is_floating(kind))


def _is_vector(kind: arrow.DataType) -> bool:
    types = arrow.types
    listed = types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)
    return bool(
        listed and (types.is_integer(kind.value_type) or types.is_floating(kind.value_type))
    )


def _vector_entries(path: Path, name: str, column: arrow.ChunkedArray) -> dict[str, np.ndarray]:
    """Return the entries of vectors of equal length; none for other columns."""
    length = len(column[0].as_py() or ()) if len(column) else 0
    if not 0 < length <= _MAX_VECTOR_LENGTH:
        return {}
    rows = column.to_pylist()
    if any(row is None or len(row) != length for row in rows):
        return {}
    table = np.array(rows, dtype=float)
    names = vector_names(path, name)
    if len(names) != length:
        names = [str(k) for k in range(length)]
    return {f"{name}.{entry}": table[:, k] for k, entry in enumerate(names)}
