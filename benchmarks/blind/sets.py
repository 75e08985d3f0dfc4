"""Recording sets made from others: columns and description changed, nothing else."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Columns = dict[str, np.ndarray]
Change = Callable[[str, Columns], Columns]


def description(case: Path) -> dict[str, Any]:
    """Content of recordings.toml."""
    return tomllib.loads((case / "recordings.toml").read_text(encoding="utf-8"))


def write_set(
    source: Path, target: Path, told: dict[str, Any], change: Change | None = None
) -> Path:
    """Copy a set with another description, its runs passed through a change.

    Parameters
    ----------
    source, target : Path
    told : dict
        The new content of recordings.toml.
    change : callable, optional
        From name and columns of a run to its new columns.
    """
    target.mkdir(parents=True, exist_ok=True)
    shutil.copy(source / told["robot"], target / told["robot"])
    for run in told["runs"]:
        if change is None:
            shutil.copy(source / run["file"], target / run["file"])
            continue
        with np.load(source / run["file"]) as read:
            columns = {name: read[name] for name in read.files}
        columns = change(Path(run["file"]).stem, columns)
        np.savez_compressed(target / run["file"], allow_pickle=False, **columns)
    (target / "recordings.toml").write_text(toml_text(told), encoding="utf-8")
    return target


def toml_text(told: dict[str, Any]) -> str:
    """TOML of a description: plain values, tables of values, lists of tables."""
    plain = {k: v for k, v in told.items() if not _table(v)}
    return "\n".join([_lines(plain), *(_part(k, v) for k, v in told.items() if _table(v))])


def _table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _part(name: str, value: Any) -> str:
    if isinstance(value, list):
        return "\n".join(f"[[{name}]]\n{_lines(item)}" for item in value)
    plain = {k: v for k, v in value.items() if not _table(v)}
    inner = [_part(f"{name}.{k}", v) for k, v in value.items() if _table(v)]
    return "\n".join([f"[{name}]", _lines(plain), *inner])


def _lines(values: dict[str, Any]) -> str:
    return "".join(f"{key} = {_value(value)}\n" for key, value in values.items())


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list):
        return "[" + ", ".join(_value(each) for each in value) + "]"
    return repr(value)
