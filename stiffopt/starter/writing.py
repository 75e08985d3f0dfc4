"""Text of TOML files that people go on with, and files that are never overwritten."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

from stiffopt.errors import InputFileError
from stiffopt.files import atomic_write


def write_new(path: Path, text: str) -> Path:
    """Write a file that is not there yet.

    Raises
    ------
    InputFileError
        It is there: what a person has changed is not written over.
    """
    if path.exists():
        raise InputFileError(path, "", "is there already and is kept. Give another --out.")
    atomic_write(path, text)
    return path


def toml_string(text: str) -> str:
    """Text as TOML and JSON have it."""
    return json.dumps(text, ensure_ascii=False)


def toml_list(values: Iterable[str]) -> str:
    """List of entries that are TOML already."""
    return f"[{', '.join(values)}]"


def toml_number(value: float, digits: int = 6) -> str:
    """Number as TOML has it, always with a point or an exponent."""
    text = f"{value:.{digits}g}"
    return text if any(mark in text for mark in ".en") else f"{text}.0"


def relative_path(path: Path, folder: Path) -> str:
    """Path relative to a folder, with slashes."""
    return Path(os.path.relpath(path, folder)).as_posix()


def toml_key(name: str) -> str:
    """Key of a TOML table, quoted where it has to be."""
    plain = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if plain else toml_string(name)
