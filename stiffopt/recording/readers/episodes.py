"""Which episode of which file a run names, and the dataset that the file belongs to."""

from __future__ import annotations

from pathlib import Path

from stiffopt.errors import InputFileError


def split_episode(path: Path) -> tuple[Path, int | None]:
    """File and number of the episode of "FILE.parquet#3"."""
    name, mark, number = path.name.rpartition("#")
    if not mark or path.exists():
        return path, None
    if not number.isdecimal():
        raise InputFileError(path, "", f"{number!r} is no episode; give its number, as in #0.")
    return path.parent / name, int(number)


def information(path: Path) -> Path | None:
    """meta/info.json of the dataset that a Parquet file belongs to; None where it has none."""
    for folder in list(path.resolve().parents)[:4]:
        found = folder / "meta" / "info.json"
        if found.is_file():
            return found
    return None
