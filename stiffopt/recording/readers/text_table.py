"""Text tables as loggers and spreadsheets write them: heads, units, separators, lists in cells."""

from __future__ import annotations

import csv
import re
from collections import Counter
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError, NoNumbersError
from stiffopt.recording.readers.clocks import join_split_stamps, parse_stamps
from stiffopt.recording.readers.columns import (
    MAX_ENTRIES,
    Table,
    expand_vectors,
    unnamed_columns,
)
from stiffopt.recording.stated_units import UNITS

_CELL_SEPARATORS = (";", "\t", ",", "|")
_NUMBER_PATTERN = re.compile(r"^[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?$")
# Numbers with unambiguous thousands separators: 1.234,5 and 1,234.5, and with apostrophes or spaces
# 1'234.5 and 1 234; not 1.234.
_GROUPED_PATTERN = re.compile(
    r"^[+-]?\d{1,3}((\.\d{3})+,\d*|(,\d{3})+\.\d*|([.,]\d{3}){2,}"
    r"|(['\u2019 \u00a0\u202f]\d{3})+([.,]\d*)?)$"
)
# Longest line [characters]: hundreds of columns; Python's csv reads no longer cell.
MAX_LINE = 2**17
# A vector in a cell, as lists of Python and arrays of NumPy are printed.
_VECTOR_PATTERN = re.compile(r"^(?:array)?\(?[\[(](.*?)[\])],?(?:\s*dtype=\w+)?\)?$", re.DOTALL)
# The same between quotes, over several lines.
_BROKEN_VECTOR_PATTERN = re.compile(r'"[\[(][^"\]]*[\])]"')


def read_text_table(text: str, path: Path) -> Table:
    """Read a table from text of any layout."""
    if '"' in text:
        text = _BROKEN_VECTOR_PATTERN.sub(lambda found: " ".join(found[0].split()), text)
    lines = [line for line in text.splitlines() if line.strip()]
    longest = max(map(len, lines), default=0)
    if longest > MAX_LINE:
        raise InputFileError(
            path, "", f"is no table: a line has {longest} characters, at most {MAX_LINE} are read."
            " Write one line for each sample."
        )  # fmt: skip
    comments = [line for line in lines if line.lstrip()[:1] in "#%"]
    body = [line for line in lines if line.lstrip()[:1] not in "#%"]
    if not body:
        raise NoNumbersError(path, "", "holds no numbers.")
    mark = _find_separator(body)
    return table_of_rows(
        [_split_cells(line, mark) for line in body],
        [_split_cells(line.lstrip("#% "), mark) for line in comments[-1:]],
        path,
    )


def table_of_rows(rows: list[list[str]], comments: list[list[str]], path: Path) -> Table:
    """Return the table of rows of cells, below heads, or below the last comment.

    Columns without names are "column 1", "column 2", ...
    """
    width = Counter(len(row) for row in rows).most_common(1)[0][0] if rows else 0
    first = next((k for k, row in enumerate(rows) if len(row) == width and _is_data(row)), None)
    if first is None:
        begins = f" It begins: {' '.join(rows[0])[:80]!r}." if rows else ""
        raise NoNumbersError(path, "", f"holds no row of numbers.{begins}")
    cells = rows[first:]
    names = _find_names(rows[:first], comments, width)
    if names is None:
        names = _name_echoed_columns(cells, width) or unnamed_columns(width)
    table: Table = {}
    for k, name in enumerate(names):
        table |= _columns_of_cells(name, [row[k] if k < len(row) else "" for row in cells])
    return join_split_stamps(table)


def _columns_of_cells(name: str, cells: list[str]) -> Table:
    """Return the columns of cells: numbers, time stamps, or entries of vectors; none of texts."""
    if _VECTOR_PATTERN.match(cells[0]):
        vectors = [_parse_vector(cell) for cell in cells]
        length = len(vectors[0])
        # A last line may be cut off within its vector.
        known = [v if len(v) == length else [float("nan")] * length for v in vectors]
        if not 0 < length <= MAX_ENTRIES:
            return {}
        return (
            {f"{name}[0]": np.array(known)[:, 0]}
            if length == 1
            else expand_vectors(name, np.array(known))
        )
    numbers = np.array([_parse_number(cell) for cell in cells])
    if np.isnan(numbers).all():
        seconds = parse_stamps(cells)
        return {} if seconds is None else {name: seconds}
    return {name: numbers}


def _parse_vector(cell: str) -> list[float]:
    found = _VECTOR_PATTERN.match(cell)
    inner = "" if found is None else found[1]
    parts = inner.split(",") if "," in inner else inner.split()
    return [_parse_number(part.strip()) for part in parts if part.strip()]


def _name_echoed_columns(cells: list[list[str]], width: int) -> list[str] | None:
    """Return names of the columns of `ros2 topic echo --csv` of joint states; None for others.

    Each row holds the stamp, the frame, the joints' names, then positions, velocities and efforts.
    """
    row = cells[0]
    words = [k for k, cell in enumerate(row) if k > 2 and np.isnan(_parse_number(cell)) and cell]
    if not words or words != list(range(3, 3 + len(words))):
        return None
    joints = [row[k] for k in words]
    kinds = ("position", "velocity", "effort")[: (width - 3) // len(joints) - 1]
    names = ["stamp.sec", "stamp.nanosec", "frame", *(f"name {joint}" for joint in joints)]
    names += [f"{kind}[{joint}]" for kind in kinds for joint in joints]
    return names if len(names) == width else None


def _find_names(head: list[list[str]], comments: list[list[str]], width: int) -> list[str] | None:
    """Return the column names from the last header row, with units of a unit row added."""
    # An empty last column may have a name and lack a unit.
    words = [row[:width] for row in head if width <= len(row) <= width + 1]
    words += [[*row, ""] for row in head[-1:] if len(row) == width - 1 and _is_units(row)]
    if not words and comments:
        words = [row for row in comments if len(row) == width]
    if not words:
        return None
    named = words[-1]
    if len(words) > 1 and _is_units(named):
        units = [unit.strip("[]() ") for unit in named]
        named = [f"{n} [{u}]" if u else n for n, u in zip(words[-2], units, strict=True)]
    # A data frame leaves its index without a name.
    return _number_duplicates(
        [name or unnamed for name, unnamed in zip(named, unnamed_columns(width), strict=False)]
    )


def _is_units(cells: list[str]) -> bool:
    """Return True for a row of units: bracketed or known, at least half of them known."""
    there = [cell for cell in cells if cell]
    known = [cell for cell in there if cell.strip("[]() ").lower() in UNITS]
    bracketed = [cell for cell in there if cell[0] in "[(" and cell[-1] in ")]"]
    return 2 * len(known) >= len(there) > 0 and len({*known, *bracketed}) == len(set(there))


def _number_duplicates(names: list[str]) -> list[str]:
    """Number duplicate names so that no column hides another."""
    count = Counter(names)
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        seen[name] += 1
        unit = re.search(r"\s*[\[(][^\])]*[\])]\s*$", name)
        cut = unit.start() if unit is not None else len(name)
        own = f"{name[:cut]} {seen[name]}{name[cut:]}".strip() if count[name] > 1 else name
        found.append(own)
    return found


def decode_text(raw: bytes) -> str:
    """Return the text of a file in UTF-8, UTF-16 or, where it is neither, Latin-1."""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _find_separator(body: list[str]) -> str:
    """Return the separator that splits all lines into equally many cells; "" is white space."""
    probe = body[len(body) // 2 : len(body) // 2 + 20]
    for mark in _CELL_SEPARATORS:
        counts = {len(next(csv.reader([line], delimiter=mark), [])) for line in probe}
        if len(counts) == 1 and max(counts) > 1:
            return mark
    return ""


def _split_cells(line: str, mark: str) -> list[str]:
    if not mark:
        return line.split()
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=mark), [])]
    return cells[:-1] if cells and not cells[-1] else cells


def _is_data(row: list[str]) -> bool:
    numbers = sum(
        bool(
            _NUMBER_PATTERN.match(cell)
            or _GROUPED_PATTERN.match(cell)
            or (cell[:1] in "[(a" and np.isfinite(_parse_vector(cell)).any())
        )
        for cell in row
        if cell
    )
    return numbers * 2 > len(row)


def _parse_number(cell: str) -> float:
    if _GROUPED_PATTERN.match(cell):
        cell = _remove_grouping(cell)
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return float("nan")


def _remove_grouping(cell: str) -> str:
    """Remove the thousands separators of a number."""
    bare = re.sub(r"[^\d.,+-]", "", cell)
    marks = [mark for mark in bare if mark in ".,"]
    if len(set(marks)) < len(marks) or len(set(marks)) == 2:
        # The first mark separates thousands; a different last one is the decimal mark.
        bare = bare.replace(marks[0], "")
    return bare
