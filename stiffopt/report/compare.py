"""Comparison of two result folders, entry by entry."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

from stiffopt.errors import InputFileError, format_increase
from stiffopt.files import load_json
from stiffopt.folders import check_result
from stiffopt.report.common.text import DASH, percent, si, words

ANSWERS = ("result.json", "diagnosis.json", "study.json", "stiffness.json")
_IGNORED_ENTRIES = (
    "versions",
    "solver",
    "inputs_hash",
    "detection_limits",
    "faults",
    "homotopy",
    "seal",
)
# SI units of entries that have one name in all answers.
_ENTRY_UNITS = {
    "duration": "s",
    "time": "s",
    "settling_time": "s",
    "peak": "m",
    "rms": "m",
    "along": "m",
    "across": "m",
    "orientation": "rad",
    "settling_band": "m",
    "typical_hysteresis": "m",
}

Row = tuple[str, str, str, str]


def compare_results(first: Path, second: Path) -> tuple[str, list[Row]]:
    """Return the name of the result file and one row per differing entry.

    Raises `InputFileError`: a folder has no result file, or the two are of different kinds.
    """
    names = [_find_answer(folder) for folder in (first, second)]
    if names[0] != names[1]:
        raise InputFileError(
            second, "", f"holds {names[1]}, {first} holds {names[0]}. Compare two of one kind."
        )
    one, two = (load_json(folder / names[0]) for folder in (first, second))
    units = _objective_unit(one), _objective_unit(two)
    rows = []
    for key, a, b in _differences(one, two):
        was, now = (
            _format_value(value, _unit_of(key, unit))
            for value, unit in zip((a, b), units, strict=True)
        )
        rows.append((quantity(key), was, now, _format_change(key, a, b)))
    return names[0], rows


def quantity(key: str) -> str:
    """Return the path of an entry in words.

    >>> quantity("certificate.violations[2].value"), quantity("baselines.toppra.duration")
    ('certificate, violations 2, value', 'baselines, toppra, duration')
    """
    parts = [re.sub(r"\[(\d+)\]", r" \1", part) for part in key.split(".")]
    return ", ".join(words(part).strip() for part in parts)


def _objective_unit(document: Any) -> str:
    """Return the unit of the objective's value, or ""."""
    objective = document.get("objective") if isinstance(document, dict) else None
    return str(objective.get("unit", "")) if isinstance(objective, dict) else ""


def _unit_of(key: str, objective: str) -> str:
    """Return the SI unit of an entry by its name; `objective` is that of objective values."""
    place = re.sub(r"\[\d+\]", "", key)
    if place == "objective.value" or re.fullmatch(
        r"(baselines\..+|strict_baseline)\.objective", place
    ):
        return objective
    return _ENTRY_UNITS.get(place.rpartition(".")[2], "")


def _find_answer(folder: Path) -> str:
    for name in ANSWERS:
        check_result(folder, name)
        if (folder / name).is_file():
            return name
    raise InputFileError(
        folder, "", f"is no folder of results: it has none of {', '.join(ANSWERS)}."
    )


def _differences(a: Any, b: Any, place: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield entries that differ; numbers of a list, or what only one has, are one entry."""
    a, b = _by_limit(a), _by_limit(b)
    if isinstance(a, dict) and isinstance(b, dict):
        for key in dict.fromkeys((*a, *b)):
            if key not in _IGNORED_ENTRIES:
                yield from _differences(a.get(key), b.get(key), f"{place}.{key}".lstrip("."))
    elif isinstance(a, list) and isinstance(b, list) and not (_are_numbers(a) and _are_numbers(b)):
        for number, (own, other) in enumerate(zip_longest(a, b), start=1):
            yield from _differences(own, other, f"{place}[{number}]")
    elif not _is_equal(a, b):
        yield place, a, b


def _by_limit(value: Any) -> Any:
    """Return violations, which are sorted by size, by their limits."""
    if not isinstance(value, list) or not all(isinstance(x, dict) and "limit" in x for x in value):
        return value
    owners = [
        f"joint {x['joint']}" if x.get("joint") else " and ".join(x.get("pair", ())) for x in value
    ]
    return {
        f"{x['limit']} of {owner}" if owner else x["limit"]: x
        for x, owner in zip(value, owners, strict=True)
    }


def _are_numbers(values: list[Any]) -> bool:
    return all(isinstance(each, float | int) for each in values)


def _is_equal(a: Any, b: Any) -> bool:
    if isinstance(a, float | int) and isinstance(b, float | int):
        # Relative difference below which two numbers count as equal.
        return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-15)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_is_equal, a, b))
    return bool(a == b)


def _format_value(value: Any, unit: str) -> str:
    if value is None:
        return DASH
    if isinstance(value, float):
        return si(value, unit, 6)
    if isinstance(value, dict):
        return f"{len(value)} entries"
    if isinstance(value, list) and (not value or not _are_numbers(value)):
        value = ", ".join(map(str, value))
    if isinstance(value, list):
        least, most = (si(float(each), unit, 4) for each in (min(value), max(value)))
        return f"{len(value)} values, {least} to {most}"
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _format_change(key: str, a: Any, b: Any) -> str:
    if key.rpartition(".")[2] == "joint":
        # A joint number has no relative change.
        return ""
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        # Of the value that changes most beside the largest.
        most = max(range(len(a)), key=lambda k: abs(b[k] - a[k]))
        share = abs(b[most] - a[most]) / (max(map(abs, a)) or 1.0)
        return f"up to {percent(share)} of the largest"
    numbers = all(isinstance(v, float | int) and not isinstance(v, bool) for v in (a, b))
    return format_increase(b, a, 3) if numbers and a else ""
