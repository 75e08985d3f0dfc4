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
# What must be as it was committed: the tool, and what cases are made with.
FROZEN = (
    "stiffopt",
    "benchmarks/simulator",
    *(
        f"benchmarks/blind/{name}.py"
        for name in ("cases", "key", "mix", "oracle", "sealed_tool", "severity", "tool")
    ),
)

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


def key_under_test(given: str | None = None, commit: str = "HEAD") -> Key:
    """The key of a commit whose tool and cases are those that are checked out.

    Parameters
    ----------
    given : str, optional
        A key for development in its place; begins with "dev-".
    commit : str
        Any name that git knows it by.

    Raises
    ------
    ValueError
        For a given key that could be mistaken for a drawn one, or a commit that git does not know.
    """
    try:
        full = _git("rev-parse", "--verify", f"{commit}^{{commit}}")
    except subprocess.CalledProcessError as error:
        raise ValueError(f"git knows no commit {commit!r}") from error
    if given is not None:
        if not given.startswith(DEVELOPMENT):
            raise ValueError(f"a given key begins with {DEVELOPMENT!r}, not {given!r}")
        return Key(given, full)
    changed = _git("diff", "--name-only", full, "--", *FROZEN)
    untracked = _git("ls-files", "--others", "--exclude-standard", "--", *FROZEN)
    digest = hashlib.sha256(full.encode()).hexdigest()
    return Key(digest + (DIRTY if changed or untracked else ""), full)
