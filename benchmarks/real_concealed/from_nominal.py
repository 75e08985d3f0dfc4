"""Answers that start from the nominal model: right, in a group, missed, and false claims."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.blind.extras import table
from benchmarks.blind.score import Named
from benchmarks.blind.wilson import Rate
from benchmarks.real_claims import CLAIM_PROBABILITY, FRICTION_NAMES

# Combined standard deviations within which a change of a value is right.
AGREEMENT_DEVIATIONS = 2.0
OUTCOMES = ("right", "in group", "missed")


def outcome(found: dict[str, Any], parameter: str, hidden: float) -> str | None:
    """Outcome of a case; None where the tool did not answer from the nominal model.

    What the set shows without the concealment may have the same name: then its parameter must have
    changed by the hidden amount.
    """
    findings = found.get("from_nominal")
    if findings is None:
        return None
    truth = [Named.read(each) for each in found["truth"]]
    before = [f for f in found["without"] if Named.read(f) in truth]
    for finding in findings:
        if Named.read(finding) in truth and _changed(before, finding, parameter, hidden):
            return "right"
    rivals = [f for finding in findings for f in (finding, *finding["confused_with"])]
    return "in group" if any(Named.read(f) in truth for f in rivals) else "missed"


def _changed(
    before: Sequence[dict[str, Any]], finding: dict[str, Any], parameter: str, hidden: float
) -> bool:
    """A finding is new, or its parameter has changed by the hidden amount."""
    if not before or parameter not in finding["parameters"]:
        return not before
    first, said = (f["parameters"].get(parameter) for f in (before[0], finding))
    if first is None or first["sd"] is None or said["sd"] is None:
        return False
    change = said["value"] - first["value"]
    spread = float(np.hypot(said["sd"], first["sd"]))
    return bool(abs(change - hidden) <= AGREEMENT_DEVIATIONS * spread)


def claims(found: dict[str, Any], apart: frozenset[str] = frozenset()) -> list[bool]:
    """For each claim, but of effects `apart`: is it neither hidden nor shown without that?"""
    known = {Named.read(f) for f in found["without"]} | {Named.read(t) for t in found["truth"]}
    return [
        Named.read(f) not in known
        for f in found.get("from_nominal") or []
        if f["probability"] >= CLAIM_PROBABILITY and f["effect"] not in apart
    ]


def section(
    rows: Sequence[tuple[Any, dict[str, Any]]],
    name: Callable[[Any], str],
    value: Callable[[Any], float],
) -> str:
    """Markdown: outcomes by size, and false claims.

    Parameters
    ----------
    rows : sequence of (Plan, dict)
        Concealments that have a size.
    name, value : callable
        Name of a row's hidden parameter, and its amount [SI].
    """
    by_size: dict[float, list[str]] = {}
    for row in rows:
        said = outcome(row[1], name(row), value(row))
        if said is not None:
            by_size.setdefault(float(row[1]["size"]), []).append(said)
    lines = [
        (f"{size:g}", str(len(said)), *(str(said.count(each)) for each in OUTCOMES))
        for size, said in sorted(by_size.items())
    ]
    large = [each for size, said in by_size.items() if size >= 4.0 for each in said]
    false, beyond = (
        Rate.of(each for row in rows for each in claims(row[1], apart))
        for apart in (frozenset(), FRICTION_NAMES)
    )
    return "\n".join(
        [
            "## From the nominal model\n",
            table(("size", "cases", *OUTCOMES), lines),
            f"Of 4 and more: right or in group {Rate.of(x != 'missed' for x in large)}.",
            f"Claims at P >= {CLAIM_PROBABILITY} that are false: {false}; beyond friction, rotors"
            f" and offsets, which every joint has: {beyond}.\n",
        ]
    )
