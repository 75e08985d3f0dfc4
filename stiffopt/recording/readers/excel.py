"""Run files of Excel: the sheets of an .xlsx workbook as tables."""

from __future__ import annotations

from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any

from openpyxl import load_workbook

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.checks import check_numbers
from stiffopt.recording.readers.columns import Table
from stiffopt.recording.readers.text_table import table_of_rows


def read_tables(path: Path) -> dict[str, Table]:
    """Read the tables of a workbook by sheet; "" where only one sheet has a table."""
    workbook = load_workbook(path, read_only=True, data_only=True)
    try:
        found: dict[str, Table] = {}
        refused: InputFileError | None = None
        for sheet in workbook.worksheets:
            rows = _read_rows(sheet, path)
            try:
                found[sheet.title] = table_of_rows(rows, [], path)
            except InputFileError as error:
                refused = error
    finally:
        workbook.close()
    if not found:
        raise refused or InputFileError(path, "", "has no sheet with numbers.")
    return {"": next(iter(found.values()))} if len(found) == 1 else found


def _read_rows(sheet: Any, path: Path) -> list[list[str]]:
    rows: list[list[str]] = []
    for row in sheet.iter_rows(values_only=True):
        cells = [_format_cell(cell) for cell in row]
        if any(cells):
            rows.append(cells)
            check_numbers(path, len(rows), len(cells))
    return rows


def _format_cell(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, datetime | time):
        return cell.isoformat()
    return repr(cell) if isinstance(cell, float) else str(cell).strip()
