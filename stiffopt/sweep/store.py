"""Files of a sweep: table.csv, table.parquet and sweep.json, beside one file a case."""

from __future__ import annotations

import io
import json
from pathlib import Path

from stiffopt.files import atomic_write, to_json_types, write_csv
from stiffopt.sweep.summary import SweepSummary

SUMMARY_FILE = "sweep.json"
TABLE_FILE = "table.csv"
PARQUET_FILE = "table.parquet"


def write_sweep(summary: SweepSummary, directory: str | Path) -> Path:
    """Write table and summary; return the table's path. Parquet only where pyarrow is installed."""
    folder = Path(directory)
    columns = summary.columns()
    rows = zip(*columns.values(), strict=True)
    write_csv(folder / TABLE_FILE, list(columns), rows)
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        pass
    else:
        # Columns of numbers and of texts with a unit alike: pyarrow wants one kind a column.
        uniform = {
            name: [None if c is None else str(c) for c in cells]
            if any(isinstance(c, str) for c in cells)
            else cells
            for name, cells in columns.items()
        }
        stream = io.BytesIO()
        parquet.write_table(pyarrow.table(uniform), stream)
        atomic_write(folder / PARQUET_FILE, stream.getvalue())
    text = json.dumps(
        to_json_types(summary.document()), indent=1, ensure_ascii=False, allow_nan=False
    )
    atomic_write(folder / SUMMARY_FILE, text + "\n")
    return folder / TABLE_FILE
