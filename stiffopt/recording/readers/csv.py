"""Run files of text: tables with one sample a line, JSON, and messages printed by ROS."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError, shortened
from stiffopt.files import read_bytes, read_text
from stiffopt.recording.readers import json_log, text_table, topic_echo
from stiffopt.recording.readers.checks import MAX_BYTES, check_columns, check_numbers, require_time
from stiffopt.recording.readers.columns import Table, select_columns
from stiffopt.recording.signals import Signals

# The RTDE recorder of Universal Robots writes blanks.
_COLUMN_DELIMITERS = (",", ";", "\t", " ")
# Texts of loggers for missing samples.
_MISSING_TEXTS = ("", "nan", "na", "n/a", "null", "none", "-")


def read(path: Path, signals: Signals) -> dict[str, np.ndarray]:
    """Read columns of a text file.

    A header in the first line, with any of `_COLUMN_DELIMITERS` and "#" before it, is followed
    strictly: a cell that is no number is told. Other layouts are read as by `read_tables`.
    """
    require_time(signals, path)
    text = read_text(path, MAX_BYTES)
    first, _, body = text.lstrip("\r\n").partition("\n")
    wanted = (signals.time, *signals.wanted)
    headers = {mark: _split_header(first, mark) for mark in _COLUMN_DELIMITERS}
    mark = max(headers, key=lambda m: (sum(name in headers[m] for name in wanted), len(headers[m])))
    header = headers[mark]
    if not set(wanted) <= set(header):
        try:
            table = read_tables(path)[""]
        except InputFileError:
            check_columns(path, wanted, header)
            raise
        return select_columns(path, table, signals)
    if not body.strip():
        raise InputFileError(path, "", "holds no rows below its header. Record it again.")
    check_numbers(path, body.count("\n"), len(wanted))
    _check_widths(path, body, mark, len(header))
    places = [header.index(name) for name in wanted]
    try:
        numbers = np.loadtxt(
            io.StringIO(body), delimiter=mark, usecols=places, comments=None, ndmin=2
        )
    except ValueError:
        # Slower, but accepts empty cells and reports the place of invalid ones.
        numbers = _parse_rows(path, body, mark, wanted, places)
    return {name: numbers[:, number].copy() for number, name in enumerate(wanted)}


def read_tables(path: Path) -> dict[str, Table]:
    """Read the table of a text file of any layout, recognised by its content."""
    text = text_table.decode_text(read_bytes(path, MAX_BYTES))
    if re.match(r"\s*(\{|\[\s*[{\[])", text):
        return {"": json_log.read_text_table(text, path)}
    if topic_echo.is_topic_echo(text) or topic_echo.is_joint_trajectory(text):
        return {"": topic_echo.read_text_table(text, path)}
    return {"": text_table.read_text_table(text, path)}


def _split_header(line: str, mark: str) -> list[str]:
    row = next(csv.reader([line.lstrip("# ").rstrip("\r")], delimiter=mark), [])
    return [name.strip() for name in row]


def _check_widths(path: Path, body: str, mark: str, columns: int) -> None:
    """Raise `InputFileError` for a line with more cells than the header, unless they are blank."""
    for number, line in enumerate(body.splitlines(), start=1):
        if line.count(mark) < columns:
            continue
        cells = next(csv.reader([line], delimiter=mark), [])
        if any(cell.strip() for cell in cells[columns:]):
            raise InputFileError(
                path,
                f"row {number}",
                f"has {len(cells)} cells, the header names {columns}. Name every column, or write"
                " decimals with a point.",
            )


def _parse_rows(
    path: Path, body: str, mark: str, wanted: tuple[str, ...], places: list[int]
) -> np.ndarray:
    rows = []
    for number, cells in enumerate(csv.reader(io.StringIO(body), delimiter=mark), start=1):
        if not cells:
            continue
        if len(cells) <= max(places):
            raise InputFileError(
                path,
                f"row {number}",
                f"has {len(cells)} of at least {max(places) + 1} cells. "
                "Complete or delete the line.",
            )
        rows.append(
            [
                _parse_cell(path, number, name, cells[k])
                for name, k in zip(wanted, places, strict=True)
            ]
        )
    return np.array(rows, dtype=float).reshape(-1, len(wanted))


def _parse_cell(path: Path, row: int, column: str, text: str) -> float:
    text = text.strip()
    if text.lower() in _MISSING_TEXTS:
        return np.nan
    try:
        return float(text)
    except ValueError:
        raise InputFileError(
            path, f"row {row}, {column}", f"{shortened(text)} is no number."
        ) from None
