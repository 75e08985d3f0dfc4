"""Run files of Parquet: one column per signal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as arrow
import pyarrow.parquet as parquet

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.checks import check_columns, check_numbers, require_time
from stiffopt.recording.signals import Signals


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Read columns of a .parquet file; time stamps become seconds after the first."""
    require_time(signals, path)
    wanted = (signals.time, *signals.wanted)
    with parquet.ParquetFile(path) as file:
        check_columns(path, wanted, file.schema_arrow.names)
        check_numbers(path, file.metadata.num_rows, len(wanted))
        table = file.read(columns=list(wanted), use_threads=False)
    return {name: column_to_numbers(path, name, table.column(name)) for name in wanted}


def column_to_numbers(path: Path, name: str, column: arrow.ChunkedArray) -> np.ndarray:
    """Convert a column to numbers (K,), time stamps to seconds after the first."""
    kind = column.type
    if len(column) == 0:
        return np.empty(0)
    if arrow.types.is_timestamp(kind) or arrow.types.is_duration(kind):
        stamps = column.to_numpy().astype("timedelta64[ns]" if arrow.types.is_duration(kind)
                                          else "datetime64[ns]")  # fmt: skip
        seconds: np.ndarray = (stamps - stamps[0]) / np.timedelta64(1, "s")
        return seconds
    if not (arrow.types.is_integer(kind) or arrow.types.is_floating(kind)):
        hint = f" Name an entry: {name}[0]" if arrow.types.is_nested(kind) else ""
        raise InputFileError(path, name, f"needs a column of numbers, got {kind}.{hint}")
    return np.asarray(column.to_numpy(), dtype=float)
