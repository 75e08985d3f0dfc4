"""The key of a run, and every draw from it."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DEVELOPMENT = "dev-"
DIRTY = "-dirty"

T = TypeVar("T")


@dataclass(frozen=True)
class Key:
    """What all draws of a run follow from.

    Parameters
    ----------
    text : str
        64 hexadecimal digits; or with "dev-" before or "-dirty" behind, for development.
    commit : str
        Under test.
    """

    text: str
    commit: str

    @property
    def development(self) -> bool:
        return self.text.startswith(DEVELOPMENT) or self.text.endswith(DIRTY)

    def draw(self, *purpose: str | int) -> np.random.Generator:
        """A generator of its own for each purpose."""
        digest = hashlib.sha256("|".join([self.text, *map(str, purpose)]).encode()).digest()
        return np.random.default_rng(np.frombuffer(digest, dtype=np.uint32))

    def shuffled(self, items: Sequence[T], *purpose: str | int) -> list[T]:
        order = self.draw(*purpose).permutation(len(items))
        return [items[i] for i in order]


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def key_under_test(given: str | None = None) -> Key:
    """The key of the commit that is checked out.

    Parameters
    ----------
    given : str, optional
        A key for development in its place; begins with "dev-".

    Raises
    ------
    ValueError
        For a given key that could be mistaken for a drawn one.
    """
    commit = _git("rev-parse", "HEAD")
    if given is not None:
        if not given.startswith(DEVELOPMENT):
            raise ValueError(f"a given key begins with {DEVELOPMENT!r}, not {given!r}")
        return Key(given, commit)
    dirty = _git("status", "--porcelain", "--", "stiffopt")
    return Key(hashlib.sha256(commit.encode()).hexdigest() + (DIRTY if dirty else ""), commit)
