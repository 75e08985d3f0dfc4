"""Simulated sets in folders, diagnosed through the command line once a session."""

from __future__ import annotations

import atexit
import json
import shutil
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from simulated_sets import simulated

from benchmarks.simulator import CaseSpec, write_case
from stiffopt.cli import run


@dataclass(frozen=True)
class Answered:
    """A set, what was written about it, and what the command ended with."""

    source: Path
    out: Path
    code: int

    @property
    def document(self) -> dict[str, Any]:
        return json.loads((self.out / "diagnosis.json").read_text(encoding="utf-8"))

    def predictions(self) -> dict[str, dict[str, np.ndarray]]:
        """Arrays of every prediction by the name of its file."""
        return {p.name: columns_of(p) for p in sorted(self.out.glob("pred_*.npz"))}


@cache
def folder() -> Path:
    """Of this session, removed at its end."""
    path = Path(tempfile.mkdtemp(prefix="stiffopt-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


@cache
def written(spec: CaseSpec) -> Path:
    """A case as a folder; tests change only copies of it."""
    return write_case(simulated(spec), folder() / f"set_{len(list(folder().iterdir()))}")


@cache
def answered(spec: CaseSpec) -> Answered:
    """What the command says about a case."""
    return command(written(spec))


def command(source: Path, *options: str) -> Answered:
    """`stiffopt diagnose` of a folder."""
    out = folder() / f"out_{len(list(folder().iterdir()))}"
    return Answered(source, out, run(["diagnose", str(source), "--out", str(out), *options]))


def columns_of(path: Path) -> dict[str, np.ndarray]:
    """Arrays of an .npz."""
    with np.load(path) as stored:
        return dict(stored)


def copied(spec: CaseSpec, to: Path) -> Path:
    """A copy of a case that may be changed."""
    return Path(shutil.copytree(written(spec), to))


def contents(path: Path) -> dict[str, bytes]:
    """Bytes of every file below a folder."""
    return {p.name: p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}
