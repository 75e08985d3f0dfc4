"""Text of TOML files that people go on with, and files that are never overwritten."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

from stiffopt.errors import InputError, InputFileError, shortened
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


def quoted(text: str) -> str:
    """Text as TOML has it.

    Raises
    ------
    InputError
        A name of a file that is not UTF-8, and so no text.
    """
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise InputError(
            f"the name {shortened(text)} is not UTF-8, which a TOML file cannot hold. Rename it."
        )
    return json.dumps(text, ensure_ascii=False)


def listed(values: Iterable[str]) -> str:
    """List of entries that are TOML already."""
    return f"[{', '.join(values)}]"


def number(value: float, digits: int = 6) -> str:
    """Number as TOML has it, always with a point or an exponent."""
    text = f"{value:.{digits}g}"
    return text if any(mark in text for mark in ".en") else f"{text}.0"


def beside(path: Path, folder: Path) -> str:
    """Path relative to a folder, with slashes."""
    return Path(os.path.relpath(path, folder)).as_posix()


def key(name: str) -> str:
    """Key of a TOML table, quoted where it has to be."""
    plain = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if plain else quoted(name)
