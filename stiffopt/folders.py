"""Folders for results: made, tried, filled at once, taken back where nothing came of it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from stiffopt.errors import InputFileError


@contextmanager
def output_folder(path: Path) -> Iterator[Path]:
    """The output folder, tried before any long work; what stays empty is removed again."""
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        try:
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path):
                pass
        except OSError as error:
            raise InputFileError(
                path, "", f"the folder cannot be written: {error.strerror}. Give another as --out."
            ) from error
        yield path
    except BaseException:
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise


@contextmanager
def staged(folder: Path, last: str) -> Iterator[Path]:
    """A folder whose files go into `folder` when all of them are whole; one of them last."""
    with tempfile.TemporaryDirectory(dir=folder, prefix=".") as stage:
        yield Path(stage)
        files = (path for path in Path(stage).rglob("*") if path.is_file())
        (folder / last).unlink(missing_ok=True)
        for path in sorted(files, key=lambda path: path.name == last):
            target = folder / path.relative_to(stage)
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)
