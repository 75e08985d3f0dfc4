"""One kind of file that is spoiled, and what then reads it."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reliability.commands import ROOT

RECORDED = ROOT / "problems" / "recordings" / "two_link_friction"
CHECK = ("recording", "check", ".")


@dataclass(frozen=True)
class Subject:
    """A kind of file.

    Parameters
    ----------
    kind : str
    folder : Path
        With the file and all that it needs.
    file : str
        That is spoiled.
    spoil : callable
    read : callable
        The loader, with the file's path.
    command : tuple of str
        The same by the command line, in the folder.
    whole : bool
        Commands go on to their end; else an optimisation that begins is the end, and "accepted".
    """

    kind: str
    folder: Path
    file: str
    spoil: Callable[[bytes, random.Random], bytes]
    read: Callable[[Path], Any]
    command: tuple[str, ...]
    whole: bool = True

    def spoiled(self, content: bytes, seed: int) -> bytes:
        """The sound content, spoiled by that seed."""
        return self.spoil(content, random.Random(f"{self.kind} {seed}"))


def write_csv(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write columns under their names."""
    table = np.column_stack(list(arrays.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(arrays), comments="")
