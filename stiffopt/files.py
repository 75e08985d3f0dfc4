"""Reading and writing files: TOML, JSON and CSV with checks, atomic outputs."""

from __future__ import annotations

import csv
import difflib
import io
import json
import math
import os
import re
import tempfile
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stiffopt.errors import InputFileError, shortened

if TYPE_CHECKING:
    from stiffopt.validation import Model

# Files written by people are far smaller; larger ones are mistakes or attacks [bytes].
MAX_TEXT_BYTES = 32 * 2**20
# Size of a table that a command wrote [bytes]; an hour at 250 Hz has 500 MB.
MAX_TABLE_BYTES = 2**29
# Levels of sections in a TOML file.
MAX_NESTING = 40
# Keys of more parts are rejected beforehand: the time of tomllib grows with their square.
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{MAX_NESTING}}}""")
# Length of one text of a TOML file [characters]; regular expressions may need its square.
MAX_STRING_LENGTH = 10_000

# Of an integer of 64 bits, including the sign.
_MAX_INTEGER_DIGITS = 20


def load_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file.

    Raises `InputFileError`: no such file (with the nearest names in that folder), not text, not
    TOML (with the line), or larger, deeper or with longer integers than any such file.
    """
    path = Path(path)
    text = read_text(path)
    if text.lstrip("\ufeff \t\r\n").startswith("<"):
        raise InputFileError(
            path, "", "is no TOML but XML, such as a URDF. `stiffopt init robot URDF` writes a"
            " robot file for it, and `stiffopt init problem ROBOT` a problem to solve."
        )  # fmt: skip
    key = _LONG_KEY.search(text)
    if key is not None:
        line = text.count("\n", 0, key.start()) + 1
        raise InputFileError(path, f"line {line}", f"a key has more than {MAX_NESTING} parts.")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"at line (\d+)", str(error))
        line = int(place[1]) if place else len(text.splitlines())
        where = f"line {line}"
        raise InputFileError(path, where, f"is not valid TOML: {shortened(error)}.") from error
    except RecursionError as error:
        raise InputFileError(path, "", _TOO_DEEP_MESSAGE) from error
    except ValueError as error:  # more digits than Python reads
        raise InputFileError(path, "", "has an integer of more than 64 bits.") from error
    _check_values(path, data)
    return data


_TOO_DEEP_MESSAGE = f"is nested deeper than {MAX_NESTING} levels. Use fewer levels."


def _check_values(path: Path, data: object, where: str = "", depth: int = 0) -> None:
    """Raise `InputFileError` for excessive nesting or text length, or integers over 64 bits."""
    if depth > MAX_NESTING:
        raise InputFileError(path, "", _TOO_DEEP_MESSAGE)
    if isinstance(data, Mapping):
        for key, value in data.items():
            _check_values(path, value, f"{where}.{key}" if where else str(key), depth + 1)
    elif isinstance(data, list):
        for number, value in enumerate(data, start=1):
            _check_values(path, value, f"{where}[{number}]", depth + 1)
    elif isinstance(data, str) and len(data) > MAX_STRING_LENGTH:
        raise InputFileError(
            path, where, f"this text has more than {MAX_STRING_LENGTH} characters."
        )
    elif isinstance(data, int) and not -(2**63) <= data < 2**63:
        raise InputFileError(
            path, where, "this integer has more than 64 bits. Write a smaller number."
        )


def read_text(path: str | os.PathLike[str], most: int = MAX_TEXT_BYTES) -> str:
    """Read a UTF-8 file of at most `most` bytes, without its byte order mark.

    Raises `InputFileError`: no such file, not text, not to be read, or larger than any such file.
    """
    path = Path(path)
    content = read_bytes(path, most)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputFileError(
            path, "", f"is not UTF-8 text. Save it as a {path.suffix[1:].upper()} text file."
        ) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_bytes(path: str | os.PathLike[str], most: int = MAX_TEXT_BYTES) -> bytes:
    """Read a regular file of at most `most` bytes; raise `InputFileError` for any other."""
    path = Path(path)
    check_file(path, most)
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputFileError(path, "", f"cannot be read: {error.strerror}.") from error


_NO_SUCH_PLACE_MESSAGE = (
    "there is no such place in the file. Sections of a list are counted from 1, such as"
    " minimise[1].weight."
)


def apply_changes(data: dict[str, Any], changes: Sequence[str], path: object) -> dict[str, Any]:
    """Change entries of a file's content: "motion.duration=0.5 s", "minimise[1].weight=2".

    The value after "=" is read as TOML, else as a text. Raises `InputFileError`: no "=", or a place
    that the file does not have.
    """
    for change in changes:
        place, equals, text = change.partition("=")
        keys = re.findall(r"[^.\[\]]+|\[\d{1,9}\]", place.strip())
        if not equals or not keys:
            raise InputFileError(path, "--set", f"needs KEY=VALUE, got {shortened(change)}.")
        try:
            value = tomllib.loads(f"value = {text.strip()}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError, ValueError):
            value = text.strip()
        held: Any = data
        for key in keys[:-1]:
            held = _enter_section(held, key, place, path)
        last = keys[-1]
        if isinstance(held, list) and last.startswith("["):
            number = int(last[1:-1])
            if not 1 <= number <= len(held):
                raise InputFileError(path, f"--set {place}", f"there are {len(held)} entries.")
            held[number - 1] = value
        elif isinstance(held, dict) and not last.startswith("["):
            held[last] = value
        else:
            raise InputFileError(path, f"--set {place}", _NO_SUCH_PLACE_MESSAGE)
    return data


def _enter_section(held: Any, key: str, place: str, path: object) -> Any:
    if isinstance(held, dict) and not key.startswith("["):
        return held.setdefault(key, {})
    if isinstance(held, list) and key.startswith("[") and 1 <= int(key[1:-1]) <= len(held):
        return held[int(key[1:-1]) - 1]
    raise InputFileError(path, f"--set {place}", _NO_SUCH_PLACE_MESSAGE)


def load_json(path: str | os.PathLike[str]) -> Any:
    """Read a JSON file; raises `InputFileError` for other content."""
    try:
        return json.loads(read_text(path), parse_int=_parse_integer)
    except InputFileError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputFileError(path, "", f"is no JSON text: {shortened(error)}.") from error


def _parse_integer(text: str) -> int:
    """Integer of a JSON text; longer ones overflow a float."""
    if len(text) > _MAX_INTEGER_DIGITS:
        raise ValueError("an integer of more than 64 bits")
    return int(text)


def check_file(path: str | os.PathLike[str], most: int | None = None) -> None:
    """Raise `InputFileError` if `path` is no regular file, or is larger than `most` bytes.

    The message suggests similar file names of that folder.
    """
    path = Path(path)
    if path.is_file():
        if most is not None and path.stat().st_size > most:
            raise InputFileError(
                path, "", f"is larger than {most / 2**20:.0f} MiB. Give another file."
            )
        return
    if path.is_dir():
        raise InputFileError(path, "", "is a folder. Give the file inside it.")
    if path.is_symlink():
        raise InputFileError(
            path, "", f"is a link to {os.readlink(path)}, where no file is found. Give the file."
        )
    if path.exists():
        raise InputFileError(path, "", "is a device or a pipe. Give a regular file.")
    if path.parent.is_file():
        raise InputFileError(
            path.parent, "", "is a file: give the folder of the results, or correct the path."
        )
    if not path.parent.is_dir():
        raise InputFileError(path, "", f"there is no folder {path.parent}. Check the path.")
    here = sorted(p.name for p in path.parent.iterdir() if p.is_file())
    close = difflib.get_close_matches(path.name, here, n=3, cutoff=0.5) or [
        name for name in here if name.endswith(path.suffix)
    ]
    there = f" That folder holds: {', '.join(close[:8])}." if close else ""
    raise InputFileError(path, "", f"no such file.{there} Check the path.")


# Command that makes a file of the expected kind from one of the given kind.
_CONVERSION_ADVICE = {
    ("robot", "trajectory"): " `stiffopt init problem ROBOT` writes a problem for it."
}


# Version of the format of every file that is read or written.
SCHEMA = 1


def check_header(data: Mapping[str, Any], path: object, kind: str) -> None:
    """Check `schema` and `kind`, the keys that every file has."""
    if data.get("kind") != kind:
        got = f"got {shortened(data['kind'])}" if "kind" in data else "the key is missing"
        step = _CONVERSION_ADVICE.get((str(data.get("kind")), kind), "")
        raise InputFileError(path, "kind", f'this place needs kind = "{kind}", {got}.{step}')
    check_schema(data, path)


def check_schema(data: Mapping[str, Any], path: object) -> None:
    """Check `schema`, the version of a file's format."""
    if data.get("schema") != SCHEMA or isinstance(data.get("schema"), bool):
        got = f"got {shortened(data['schema'])}" if "schema" in data else "the key is missing"
        raise InputFileError(path, "schema", f"this version reads schema = {SCHEMA}, {got}.")


def read_document(
    path: str | os.PathLike[str], model: type[Model], kind: str, changes: Sequence[str] = ()
) -> Model:
    """Read a TOML file of one kind, with `changes` of its entries; or raise `InputFileError`."""
    # pydantic loads slowly, and help and folders do without it.
    from stiffopt.validation import validate

    data = apply_changes(load_toml(path), changes, path)
    check_header(data, path, kind)
    return validate(model, data, path)


def pick(own: object, *names: str) -> dict[str, Any]:
    """Return some attributes by name."""
    return {name: getattr(own, name) for name in names}


def to_json_types(value: object) -> Any:
    """Convert a value to JSON types, dataclasses to their fields; infinite numbers become null."""
    if hasattr(value, "__dataclass_fields__"):
        value = vars(value)
    if isinstance(value, Mapping):
        return {str(key): to_json_types(each) for key, each in value.items()}
    if hasattr(value, "tolist"):  # arrays and numbers of NumPy
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [to_json_types(each) for each in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int) else str(value)


def write_json(path: str | os.PathLike[str], document: object) -> None:
    """Write a document as JSON, atomically; values as of `to_json_types`."""
    content = to_json_types(document)
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    atomic_write(path, text + "\n")


def atomic_write(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file atomically: under a temporary name in the same folder, then renamed."""
    path = Path(path)
    # File names that are not UTF-8 contain surrogates: escape them so that JSON can read them.
    binary = content if isinstance(content, bytes) else content.encode("utf-8", "backslashreplace")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise InputFileError(path, "", f"cannot be written: {error.strerror}.") from error
    try:
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(binary)
        except OSError as error:  # no space left
            raise InputFileError(path, "", f"cannot be written: {error.strerror}.") from error
        # mkstemp makes files private: set the mode that open() would set.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def read_table(
    path: str | os.PathLike[str],
    columns: Sequence[str],
    optional: Sequence[str] = (),
    texts: Sequence[str] = (),
) -> dict[str, list[Any]]:
    """Read the numbers of a CSV file with a header, by column; `optional` and `texts` if present.

    Cells are separated by commas, or by semicolons or tabs, beside which decimals may have a comma.
    Raises `InputFileError` without at least two rows of finite numbers in every required column,
    with row (the first below the header is 1) and column.
    """
    path = Path(path)
    text = read_text(path, MAX_TABLE_BYTES)
    first = text.partition("\n")[0]
    mark = max(",;\t", key=first.count)
    try:
        reader = csv.DictReader(io.StringIO(text, newline=""), delimiter=mark)
        header = reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
        rows = list(reader)
    except csv.Error as error:
        raise InputFileError(path, "", "is not a CSV text file. Save it as one.") from error
    lacking = [column for column in columns if column not in header]
    if len(rows) < 2 or lacking:
        there = f" It has {', '.join(header[:20])}." if header and lacking else ""
        raise InputFileError(
            path, "", f"needs at least two rows and the columns {', '.join(columns)}.{there}"
        )
    for number, row in enumerate(rows, start=1):
        # csv stores cells beyond the header under None.
        if any(cell.strip() for cell in row.get(None, ())):
            raise InputFileError(
                path,
                f"row {number}",
                f"has {len(header) + len(row[None])} cells, the header names {len(header)}."
                " Name every column, or write decimals with a point.",
            )
    wanted = [*columns, *(name for name in optional if name in header)]
    decimal = "." if mark == "," else ","
    found: dict[str, list[Any]] = {
        name: [
            _parse_number(path, k, name, (row[name] or "").replace(decimal, "."))
            for k, row in enumerate(rows, start=1)
        ]
        for name in wanted
    }
    told = (name for name in texts if name in header)
    return found | {name: [(row[name] or "").strip() for row in rows] for name in told}


def _parse_number(path: Path, row: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputFileError(
            path, f"row {row}, {column}", f"needs a finite number, got {shortened(text)}."
        )
    return value


def write_csv(
    path: str | os.PathLike[str], columns: Sequence[str], rows: Iterable[Sequence[object]]
) -> None:
    """Write a CSV file atomically; floats keep their full precision."""
    atomic_write(path, csv_text(columns, rows))


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV; floats keep their full precision."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()
