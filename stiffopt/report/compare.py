"""Comparison of two result folders, entry by entry."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
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
    units = _objective_entry(one, "unit"), _objective_entry(two, "unit")
    objectives = [
        tuple(_objective_entry(each, key) for key in ("name", "measure")) for each in (one, two)
    ]
    rows = []
    for key, a, b in _differences(one, two):
        was = _format_value(a, _unit_of(key, units[0]))
        now = _format_value(b, _unit_of(key, units[1]))
        differ = _is_objective(key) and objectives[0] != objectives[1]
        change = "different objectives" if differ else _format_change(key, a, b)
        rows.append((quantity(key), was, now, change))
    return names[0], rows


def quantity(key: str) -> str:
    """Return the path of an entry in words.

    >>> quantity("certificate.violations[2].value"), quantity("baselines.toppra.duration")
    ('certificate, violations 2, value', 'baselines, toppra, duration')
    """
    parts = [re.sub(r"\[(\d+)\]", r" \1", part) for part in key.split(".")]
    return ", ".join(words(part).strip() for part in parts)


def _objective_entry(document: Any, key: str) -> str:
    """Return an entry of the objective, such as the unit of its value, or ""."""
    objective = document.get("objective") if isinstance(document, dict) else None
    return str(objective.get(key, "")) if isinstance(objective, dict) else ""


def _is_objective(key: str) -> bool:
    """Return whether an entry is, or is made of, values of the objective."""
    return bool(
        re.fullmatch(
            r"objective\.(value|terms\..+)|((baselines\..+|strict_baseline)\.)?objective"
            r"|ratio_to_better_baseline",
            key,
        )
    )


def _unit_of(key: str, objective: str) -> str:
    """Return the SI unit of an entry by its name; `objective` is that of objective values."""
    place = re.sub(r"\[\d+\]", "", key)
    if place != "ratio_to_better_baseline" and _is_objective(place):
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
    own, other = (a, b) if _are_numbers(a) and _are_numbers(b) else (_by_key(a), _by_key(b))
    if isinstance(own, dict) and isinstance(other, dict):
        for key in dict.fromkeys((*own, *other)):
            if key not in _IGNORED_ENTRIES:
                below = f"{place}.{key}".lstrip(".").replace(".[", "[")
                yield from _differences(own.get(key), other.get(key), below)
    elif not _is_equal(a, b):
        yield place, a, b


def _by_key(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    return {_list_key(each, number): each for number, each in enumerate(value, start=1)}


def _list_key(value: Any, number: int) -> str:
    """Return the number in a list; of violations, which are sorted by size, the limit."""
    if not isinstance(value, dict) or "limit" not in value:
        return f"[{number}]"
    joint = value.get("joint")
    owner = f"joint {joint}" if joint else " and ".join(value.get("pair", ()))
    return f"{value['limit']} of {owner}" if owner else str(value["limit"])


def _are_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(each, float | int) for each in value)


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
    if value and _are_numbers(value):
        least, most = (si(float(each), unit, 4) for each in (min(value), max(value)))
        return f"{len(value)} values, {least} to {most}"
    if value and isinstance(value, list) and all(isinstance(each, str) for each in value):
        value = ", ".join(value)
    if isinstance(value, dict | list):
        return f"{len(value)} entries"
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
