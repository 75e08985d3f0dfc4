"""Tables as loggers write them: any separator, decimal commas, comments, byte order marks."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from stiffopt.errors import InputError, InputFileError
from stiffopt.files import check_file

_MARKS = (";", "\t", ",", "|")
_NUMBER = re.compile(r"^[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?$")
# Far above what one recording holds.
_LARGEST = 2**30


def read_any_table(path: Path) -> dict[str, np.ndarray]:
    """Columns of numbers of a text table, an NPZ or a Parquet file, under their own names.

    Raises
    ------
    InputFileError
        No table of numbers, with what was found.
    """
    check_file(path)
    if path.stat().st_size > _LARGEST:
        raise InputFileError(path, "", "is larger than 1 GiB. Cut it into runs.")
    ending = path.suffix.lower()
    if ending == ".npz":
        return _npz(path)
    if ending == ".parquet":
        return _parquet(path)
    if ending in (".mcap", ".db3", ".bag"):
        raise InputFileError(
            path,
            "",
            "holds messages; their topics are named by hand in recordings.toml: copy"
            " problems/recordings/two_link_friction/recordings.toml and see `stiffopt explain"
            " signals.position`.",
        )
    return _text(path)


def _npz(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: np.asarray(stored[name]) for name in stored.files}
    except (ValueError, OSError, KeyError) as error:
        raise InputFileError(path, "", f"cannot be read as NPZ: {error}") from error
    found: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if array.ndim == 1 and np.issubdtype(array.dtype, np.number):
            found[name] = array.astype(float)
        elif array.ndim == 2 and np.issubdtype(array.dtype, np.number):
            columns = array if array.shape[0] >= array.shape[1] else array.T
            found |= {
                f"{name}_{k + 1}": columns[:, k].astype(float) for k in range(columns.shape[1])
            }
    return _checked(found, path)


def _parquet(path: Path) -> dict[str, np.ndarray]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: reading it needs pyarrow. Install it: pip install 'stiffopt[recordings]'"
        ) from error
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise InputFileError(path, "", f"cannot be read as Parquet: {error}") from error
    found = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
            found[name] = column.to_numpy().astype(float)
    return _checked(found, path)


def _text(path: Path) -> dict[str, np.ndarray]:
    raw = path.read_bytes()
    lines = [line for line in _decoded(raw).splitlines() if line.strip()]
    comments = [line for line in lines if line.lstrip()[:1] in "#%"]
    body = [line for line in lines if line.lstrip()[:1] not in "#%"]
    if not body:
        raise InputFileError(path, "", "holds no numbers.")
    mark = _separator(body)
    rows = [_cells(line, mark) for line in body]
    names: list[str] = []
    units: list[str] = []
    while rows and not _is_data(rows[0]):
        # A row of names, then perhaps one of units.
        head = rows.pop(0)
        if not names:
            names = head
        elif len(head) == len(names):
            units = head
    if not names and comments:
        names = _cells(comments[-1].lstrip("#% "), mark)
    if not rows:
        raise InputFileError(path, "", f"holds no row of numbers. It begins: {body[0][:80]!r}.")
    width = len(rows[0])
    if len(names) != width:
        raise InputFileError(
            path,
            "",
            f"has {width} columns but {len(names)} names. Give it one line of column names"
            f" ({'none was found' if not names else ', '.join(names[:5]) + ', ...'}).",
        )
    if units:
        names = [f"{name} [{unit.strip('[]()')}]" for name, unit in zip(names, units, strict=True)]
    table = np.array([_numbers(row, width, mark) for row in rows])
    keep = ~np.all(np.isnan(table), axis=0)
    return _checked({name: table[:, k] for k, name in enumerate(names) if keep[k]}, path)


def _decoded(raw: bytes) -> str:
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace")
    for encoding in ("utf-8-sig", "latin-1"):
        try:
            return raw.decode(encoding)
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1", errors="replace")


def _separator(body: list[str]) -> str:
    """The mark that cuts the lines into most cells alike; "" is white space."""
    probe = body[len(body) // 2 : len(body) // 2 + 20]
    for mark in _MARKS:
        counts = {line.count(mark) for line in probe}
        if len(counts) == 1 and counts != {0}:
            return mark
    return ""


def _cells(line: str, mark: str) -> list[str]:
    if not mark:
        return line.split()
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=mark), [])]
    return cells[:-1] if cells and not cells[-1] else cells


def _is_data(row: list[str]) -> bool:
    numbers = sum(bool(_NUMBER.match(cell)) for cell in row)
    return numbers * 2 > len(row)


def _numbers(row: list[str], width: int, mark: str) -> list[float]:
    return [_number(row[k], mark) if k < len(row) else np.nan for k in range(width)]


def _number(cell: str, mark: str) -> float:
    if mark != ",":
        cell = cell.replace(",", ".")
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _checked(columns: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    lengths = {len(column) for column in columns.values()}
    if len(columns) < 3 or len(lengths) != 1:
        raise InputFileError(
            path, "", f"needs a time, positions and torques; it has {', '.join(columns) or 'none'}."
        )
    return columns
