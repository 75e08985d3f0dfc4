"""Recorded tables as loggers write them: text of any format, NPZ, Parquet, MCAP and rosbag2."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputError, InputFileError
from stiffopt.files import check_file
from stiffopt.recording.readers.read import first_messages, read_bounded, read_columns
from stiffopt.recording.signals import Signals
from stiffopt.starter.clocks import join_split_stamps, parse_stamps

# Unit names of loggers and their names in `[signals.scale]`; "" is SI. "A", "%" and "counts" need a
# factor from the user.
UNITS = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "grad": "deg", "rad": "",
    "mrad": "mrad", "rev": "turn", "revs": "turn", "turn": "turn", "turns": "turn", "u": "turn",
    "deg/s": "deg/s", "°/s": "deg/s", "rad/s": "", "mrad/s": "mrad/s", "rpm": "rpm",
    "1/min": "rpm", "min-1": "rpm", "u/min": "rpm", "nm": "", "n m": "", "n*m": "", "n.m": "",
    "n-m": "", "n·m": "", "mnm": "mN*m", "knm": "kN*m", "ncm": "N*cm", "a": "A", "ma": "mA",
    "arms": "A", "%": "%", "percent": "%", "inc": "counts", "incs": "counts", "cts": "counts",
    "counts": "counts", "ticks": "counts", "ms": "ms", "msec": "ms", "us": "us", "µs": "us",
    "ns": "ns", "s": "", "sec": "", "m": "", "mm": "mm", "cm": "cm", "mm/s": "mm/s", "m/s": "",
    "n": "", "kn": "kN", "-": "",
}  # fmt: skip
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
# Upper bound of the file size [bytes], far above that of one recording.
_MAX_FILE_BYTES = 2**30


def read_any_table(path: Path) -> dict[str, np.ndarray]:
    """Read the numeric columns of a text table, an NPZ or a Parquet file by their names.

    Raises
    ------
    InputFileError
        Not a table of numbers.
    """
    check_file(path, _MAX_FILE_BYTES)
    read = {".npz": _read_npz, ".parquet": _read_parquet}.get(path.suffix.lower(), _read_text)
    return read_bounded(lambda: read(path), path, "a table")


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as stored:
        arrays = {name: np.asarray(stored[name]) for name in stored.files}
    found: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if array.ndim == 1 and np.issubdtype(array.dtype, np.number):
            found[name] = array.astype(float)
        elif array.ndim == 2 and np.issubdtype(array.dtype, np.number):
            columns = array if array.shape[0] >= array.shape[1] else array.T
            found |= {
                f"{name}_{k + 1}": columns[:, k].astype(float) for k in range(columns.shape[1])
            }
    return _check_table(found, path)


def _read_parquet(path: Path) -> dict[str, np.ndarray]:
    try:
        from stiffopt.starter.parquet_tables import parquet_columns
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: reading it needs pyarrow. Install it: pip install 'stiffopt[recordings]'"
        ) from error
    return _check_table(parquet_columns(path), path)


def _read_text(path: Path) -> dict[str, np.ndarray]:
    raw = path.read_bytes()
    lines = [line for line in _decode_text(raw).splitlines() if line.strip()]
    longest = max(map(len, lines), default=0)
    if longest > MAX_LINE:
        raise InputFileError(
            path, "", f"is no table: a line has {longest} characters, at most {MAX_LINE} are read."
            " Write one line for each sample."
        )  # fmt: skip
    comments = [line for line in lines if line.lstrip()[:1] in "#%"]
    body = [line for line in lines if line.lstrip()[:1] not in "#%"]
    if not body:
        raise InputFileError(path, "", "holds no numbers.")
    mark = _find_separator(body)
    rows = [_split_cells(line, mark) for line in body]
    width = Counter(len(row) for row in rows).most_common(1)[0][0]
    first = next((k for k, row in enumerate(rows) if len(row) == width and _is_data(row)), None)
    if first is None:
        raise InputFileError(path, "", f"holds no row of numbers. It begins: {body[0][:80]!r}.")
    names = _find_names(rows[:first], comments, width, mark)
    if names is None:
        raise InputFileError(
            path,
            "",
            f"has {width} columns without names. Give it one line of {width} column names, such as"
            " t, q1, q2, tau1, tau2, above the numbers.",
        )
    cells = rows[first:]
    table = np.array([_parse_row(row, width) for row in cells])
    for k in np.flatnonzero(np.all(np.isnan(table), axis=0)):
        seconds = parse_stamps([row[k] if k < len(row) else "" for row in cells])
        if seconds is not None:
            table[:, k] = seconds
    keep = ~np.all(np.isnan(table), axis=0)
    return _check_table({name: table[:, k] for k, name in enumerate(names) if keep[k]}, path)


def _find_names(
    head: list[list[str]], comments: list[str], width: int, mark: str
) -> list[str] | None:
    """Return the column names from the last header row, with units of a unit row added."""
    # An empty last column may have a name and lack a unit.
    words = [row[:width] for row in head if width <= len(row) <= width + 1]
    words += [[*row, ""] for row in head[-1:] if len(row) == width - 1 and _is_units(row)]
    if not words and comments:
        words = [
            row for row in [_split_cells(comments[-1].lstrip("#% "), mark)] if len(row) == width
        ]
    if not words:
        return None
    names = words[-1]
    if len(words) > 1 and _is_units(names):
        units = [unit.strip("[]() ") for unit in names]
        names = [f"{n} [{u}]" if u else n for n, u in zip(words[-2], units, strict=True)]
    return _number_duplicates(names)


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


def _decode_text(raw: bytes) -> str:
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace")
    for encoding in ("utf-8-sig", "latin-1"):
        try:
            return raw.decode(encoding)
        except UnicodeDecodeError:
            continue
    return raw.decode("latin-1", errors="replace")


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
    numbers = sum(bool(_NUMBER_PATTERN.match(cell) or _GROUPED_PATTERN.match(cell)) for cell in row)
    return numbers * 2 > len(row)


def _parse_row(row: list[str], width: int) -> list[float]:
    return [_parse_number(row[k]) if k < len(row) else np.nan for k in range(width)]


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


def _check_table(columns: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    columns = join_split_stamps(columns)
    lengths = {len(column) for column in columns.values()}
    if len(columns) < 3 or len(lengths) != 1:
        raise InputFileError(
            path, "", f"needs a time, positions and torques; it has {', '.join(columns) or 'none'}."
        )
    return columns


# Number of messages searched for topics.
_MAX_PROBED_MESSAGES = 2000
_NAME_FIELDS = ("name", "names", "joint_names")
_VALUE_FIELDS = ("position", "velocity", "effort", "torque", "current", "positions", "velocities",
          "efforts", "accelerations", "q", "qd", "tau")  # fmt: skip
# Parts of controller messages with such lists, measured before commanded.
_MESSAGE_PARTS = ("", "actual", "feedback", "measured", "state")
STAMP_COLUMN = "stamp"


def read_message_table(path: Path, joints: Sequence[str]) -> dict[str, np.ndarray]:
    """Read the columns of the joint topic, under names such as "/js.position[elbow]".

    The stamps [s] are under `TIME`.

    Raises
    ------
    InputFileError
        No topic has a number for each joint; lists the topics found.
    """
    found: dict[str, list[str]] = {}
    for topic, _, message in first_messages(path, _MAX_PROBED_MESSAGES):
        # A gripper may publish on the topic of the arm.
        if not found.get(topic):
            found[topic] = _joint_fields(topic, message, joints)
    best = max(found, key=lambda topic: len(found[topic]), default="")
    if not found.get(best):
        raise InputFileError(
            path,
            "",
            f"no topic among {', '.join(sorted(found)[:20]) or 'none'} has lists of numbers for"
            f" the joints {', '.join(joints)}. Name its fields in [signals] of recordings.toml by"
            " hand.",
        )
    fields = found[best]
    signals = Signals(
        time=STAMP_COLUMN, position=tuple(fields), velocity=None, link_position=None, torque=()
    )
    return dict(read_columns(path, signals))


def _joint_fields(topic: str, message: Any, joints: Sequence[str]) -> list[str]:
    """Return the names of message fields with a number for each joint."""
    stated: Any = next(
        (n for key in _NAME_FIELDS if (n := _get_field(message, key)) is not None), ()
    )
    # A field called "name" need not list joints.
    listed = isinstance(stated, Sequence) and not isinstance(stated, str)
    names = list(stated) if listed and all(isinstance(n, str) for n in stated) else []
    named = set(joints) <= set(names)
    found: list[str] = []
    for part in _MESSAGE_PARTS:
        holder = _get_field(message, part) if part else message
        for key in _VALUE_FIELDS:
            values = _get_field(holder, key)
            if not isinstance(values, Sequence | np.ndarray) or isinstance(values, str):
                continue
            place = f"{topic}.{part}.{key}" if part else f"{topic}.{key}"
            if named and not part and len(values) == len(names):
                found += [f"{place}[{joint}]" for joint in joints]
            elif len(values) == len(joints) and not names:
                found += [f"{place}[{j}]" for j in range(len(joints))]
            elif named and len(values) == len(names):
                found += [f"{place}[{names.index(joint)}]" for joint in joints]
    return found


def _get_field(value: Any, key: str) -> Any:
    return value.get(key) if isinstance(value, Mapping) else getattr(value, key, None)
