"""Where a run keeps its files, and how they are written: whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Store:
    """Folders of one key."""

    folder: Path

    @property
    def manifest(self) -> Path:
        return self.folder / "manifest.json"

    def case(self, name: str) -> Path:
        return self.folder / "cases" / name

    def truth(self, name: str) -> Path:
        return self.folder / "truth" / f"{name}.json"

    def oracle(self, name: str) -> Path:
        return self.folder / "oracle" / f"{name}.json"

    def oracle_predictions(self, name: str) -> Path:
        return self.folder / "oracle" / name

    def answer(self, name: str) -> Path:
        return self.folder / "answers" / name

    def made(self, name: str) -> bool:
        return (self.case(name) / "commitment.txt").exists()

    def unmade(self, name: str) -> Path:
        """Why a case could not be made."""
        return self.folder / "unmade" / f"{name}.json"

    def answered(self, name: str) -> bool:
        return (self.answer(name) / "time.json").exists()


def write_json(path: Path, content: Any) -> None:
    """Write a file in one step."""
    text = json.dumps(content, indent=1, sort_keys=True, default=float) + "\n"
    write_text(path, text)


def write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """A folder to fill beside its place; it is put there when all went well."""
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    try:
        yield partial
        if target.exists():
            shutil.rmtree(target)
        partial.chmod(0o755)
        partial.replace(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
