"""Run files of JSON: arrays by name, a list of records, or one record a line (JSON lines)."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from stiffopt.errors import InputFileError, shortened
from stiffopt.files import read_text
from stiffopt.recording.readers import columns
from stiffopt.recording.readers.checks import MAX_BYTES
from stiffopt.recording.readers.joint_trajectory import (
    columns_of_trajectory,
    find_joint_trajectory,
)


def read_tables(path: Path) -> dict[str, columns.Table]:
    """Read the table of a JSON or JSON lines file."""
    return {"": read_text_table(read_text(path, MAX_BYTES), path)}


def read_text_table(text: str, path: Path) -> columns.Table:
    """Return the columns of a JSON document, or of one record a line."""
    try:
        return _columns_of_document(json.loads(text), path)
    except json.JSONDecodeError as error:
        # Lines of records are no single document: it ends where the second record begins.
        if not error.msg.startswith("Extra data"):
            raise _invalid_json(path, error, error.lineno) from error
    except RecursionError as error:
        raise InputFileError(path, "", "is nested too deeply to be a recording.") from error
    return columns.columns_of_records(_iterate_lines(text, path), path)


def _iterate_lines(text: str, path: Path) -> Iterator[Any]:
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    for number, line in lines:
        try:
            yield json.loads(line)
        except json.JSONDecodeError as error:
            if number == lines[-1][0]:
                # The logger was stopped while it wrote its last line.
                return
            raise _invalid_json(path, error, number) from error


def _invalid_json(path: Path, error: json.JSONDecodeError, line: int) -> InputFileError:
    return InputFileError(
        path, f"line {line}", f"is not valid JSON: {shortened(error.msg)}. Record it again, or cut"
        " the file there."
    )  # fmt: skip


def _columns_of_document(document: Any, path: Path) -> columns.Table:
    planned = find_joint_trajectory(document)
    if planned is not None:
        return columns_of_trajectory(planned, path)
    if isinstance(document, Mapping):
        leaves = dict(columns.flatten_mapping(_arrays_of_data_frame(document)))
        records: list[list[Any]] = [each for each in leaves.values() if _is_records(each)]
        if records:
            longest: list[Any] = max(records, key=len)
            return columns.columns_of_records(longest, path)
        return columns.columns_of_arrays(leaves)
    if _is_records(document):
        return columns.columns_of_records(document, path)
    if isinstance(document, list) and document and isinstance(document[0], list):
        table = columns.columns_of_records(document, path)
        return dict(zip(columns.unnamed_columns(len(table)), table.values(), strict=True))
    raise InputFileError(path, "", "holds no arrays or records of numbers.")


def _is_records(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], Mapping)


def _arrays_of_data_frame(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the columns of a data frame as arrays: pandas' orients "split" and "columns"."""
    names, rows = document.get("columns"), document.get("data")
    matrix = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
    if rows and matrix and isinstance(names, list) and {len(row) for row in rows} == {len(names)}:
        return {str(name): [row[k] for row in rows] for k, name in enumerate(names)}
    if all(
        isinstance(own, Mapping) and own and all(key.isdecimal() for key in own)
        for own in document.values()
    ):
        return {name: list(own.values()) for name, own in document.items()}
    return document
