"""TOML text for files that users edit, and files that are never overwritten."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

from stiffopt.errors import InputError, InputFileError, shortened
from stiffopt.files import atomic_write


def write_new(path: Path, text: str) -> Path:
    """Write a new file; raise `InputFileError` if it exists: user changes are not overwritten."""
    if path.exists():
        raise InputFileError(path, "", "exists and is kept. Give another --out.")
    atomic_write(path, text)
    return path


def toml_string(text: str) -> str:
    """Return a quoted TOML string; raise `InputError` for a file name that is not UTF-8."""
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise InputError(
            f"the name {shortened(text)} is not UTF-8, which a TOML file cannot hold. Rename it."
        )
    return json.dumps(text, ensure_ascii=False)


def toml_list(values: Iterable[str]) -> str:
    """Return a TOML list of formatted entries."""
    return f"[{', '.join(values)}]"


def toml_number(value: float, digits: int = 6) -> str:
    """Return a TOML float, always with a point or an exponent."""
    text = f"{value:.{digits}g}"
    return text if any(mark in text for mark in ".en") else f"{text}.0"


def relative_path(path: Path, folder: Path) -> str:
    """Return the path relative to a folder, with slashes."""
    return Path(os.path.relpath(path, folder)).as_posix()


def toml_key(name: str) -> str:
    """Return a TOML key, quoted if necessary."""
    plain = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if plain else toml_string(name)
