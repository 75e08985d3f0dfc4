from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recording_sets import TOML, URDF, Columns, motion


@pytest.fixture
def columns() -> Columns:
    return motion()


@pytest.fixture
def make_set(tmp_path: Path) -> Callable[..., Path]:
    """Write a set: `toml` edited by (old, new) pairs, runs by name of file."""

    def write(*edits: tuple[str, str], **runs: Columns) -> Path:
        text = TOML
        for old, new in edits:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "recordings.toml").write_text(text)
        (tmp_path / "robot.urdf").write_text(URDF)
        for name, run in {"one": motion(seed=1), "two": motion(seed=2), **runs}.items():
            np.savez(tmp_path / f"{name}.npz", **run)
        return tmp_path

    return write
