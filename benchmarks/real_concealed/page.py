"""The page of results: rates by size, kind and set, controls, intervals, every case."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.blind.extras import table
from benchmarks.blind.key import Key
from benchmarks.blind.score import Named
from benchmarks.blind.wilson import Rate

from . import from_nominal
from .draw import SIZES, Plan

# Units of hidden amounts that are not SI's own.
_UNITS = {"delay": 1e-3, "backlash": 1e-5}
Row = tuple[Plan, dict[str, Any]]
HEAD = """# Hidden in recordings of real robots

Known things, hidden by a sealed draw in public recordings of real robots: put into the recorded
torques or link angles (bodies as what inverse dynamics of the changed robot adds), or into a
nominal stiffness. The tool starts from the model that it found for the set without
them, so that what it names is the difference. *Size* is the root mean square of what is hidden over
what that model leaves on runs left out, in the torque (or link angle) where it is largest, over the
runs that are fitted or those left out, whichever show less of it. A factor on a stiffness has no
multiples: its size is what it happens to be.
`python -m benchmarks.real_concealed` makes this page, and goes on where it was interrupted.
"""


def page(key: Key, rows: Sequence[Row], planned: int) -> str:
    """Markdown of all that was answered."""
    hidden = [r for r in rows if r[0].kind is not None]
    sized = [r for r in hidden if r[1]["size"]]
    controls = [r for r in rows if r[0].kind is None]
    kind = "development key" if key.development else "key: sha256 of the commit"
    parts = [
        HEAD,
        f"Commit {key.commit[:12]}, {kind}; {len(rows)} of {planned} answered.\n",
        "## By size\n",
        _by(sized, lambda r: f"{r[1]['size']:g}", [f"{x:g}" for x in SIZES]),
        f"Of 4 and more: first in {Rate.of(_first(r) for r in sized if r[1]['size'] >= 4.0)}.\n",
        "## By kind\n",
        _by(hidden, lambda r: _name(r), sorted({_name(r) for r in hidden})),
        "## By set\n",
        _by(hidden, lambda r: r[0].source, sorted({r[0].source for r in hidden})),
        from_nominal.section(sized, lambda r: r[0].kind.parameter if r[0].kind else "", _value),
        "## Controls\n",
        f"Named where nothing is hidden: {Rate.of(bool(r[1]['findings']) for r in controls)}.\n",
        "## Intervals\n",
        f"95 % intervals that hold the truth: {Rate.of(_covered(r) for r in hidden)}.\n",
        "## Every case\n",
        table(
            ("case", "set", "hidden", "size", "said", "found"),
            [_line(row) for row in rows],
        ),
    ]
    return "\n".join(parts)


def _name(row: Row) -> str:
    return row[0].kind.name if row[0].kind else "control"


def _truth(row: Row) -> list[Named]:
    return [Named.read(each) for each in row[1]["truth"]]


def _first(row: Row) -> bool:
    """Effect and joint first; a wrong sign stopped at the door."""
    plan, found = row
    assert plan.kind is not None
    if plan.kind.where == "sign":
        return bool(found["stopped"])
    said = [Named.read(f) for f in found["findings"]]
    return bool(said) and said[0] in _truth(row)


def _anywhere(row: Row) -> bool:
    """Named, or among the rivals of what is."""
    found = row[1]
    if found["stopped"]:
        return True
    truth = _truth(row)
    every = [f for finding in found["findings"] for f in (finding, *finding["confused_with"])]
    return any(Named.read(f) in truth for f in every)


def _covered(row: Row) -> bool | None:
    plan, found = row
    assert plan.kind is not None
    name, truth = plan.kind.parameter, _value(row)
    if not name or plan.kind.where == "sign":
        return None
    for finding in found["findings"]:
        if Named.read(finding) in _truth(row) and name in finding["parameters"]:
            said = finding["parameters"][name]
            if said["sd"] is None:
                return None
            return bool(abs(said["value"] - truth) <= 1.96 * said["sd"])
    return None


def _value(row: Row) -> float:
    """The hidden parameter [SI]: what a model in front of it lacks."""
    plan, amount = row[0], float(row[1]["amount"])
    assert plan.kind is not None
    if plan.kind.where == "stiffness":
        return 1.0 / amount
    return _UNITS.get(plan.kind.name, 1.0) * amount


def _by(rows: Sequence[Row], of: Callable[[Row], str], groups: Iterable[str]) -> str:
    lines = []
    for group in groups:
        own = [r for r in rows if of(r) == group]
        first, anywhere = Rate.of(map(_first, own)), Rate.of(map(_anywhere, own))
        lines.append((group, str(len(own)), str(first), str(anywhere)))
    return table(("", "cases", "effect and joint first", "named or among rivals"), lines)


def _line(row: Row) -> tuple[str, ...]:
    plan, found = row
    said = ", ".join(Named.read(f).label for f in found["findings"])
    told = said or ("stopped: doubted" if found["stopped"] else str(found["verdict"]))
    if plan.kind is None:
        return (plan.name, plan.source, "nothing", "", told, "no" if not said else "named")
    where = "" if plan.kind.every else f" J{found['joint'] + 1}"
    size = f"{found['size']:.2g}" if found["size"] else ""
    told += _beside(row)
    verdict = "first" if _first(row) else "among" if _anywhere(row) else "no"
    return (plan.name, plan.source, plan.kind.name + where, size, told, verdict)


def _beside(row: Row) -> str:
    """The hidden value beside the one that is said."""
    plan, found = row
    assert plan.kind is not None
    for finding in found["findings"]:
        said = finding["parameters"].get(plan.kind.parameter)
        if said is not None and Named.read(finding) in _truth(row):
            sd = said["sd"] if said["sd"] is not None else np.nan
            return (
                f" ({plan.kind.parameter} {_value(row):.3g}, said {said['value']:.3g} ± {sd:.2g})"
            )
    return ""
