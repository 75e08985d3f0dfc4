"""What a sweep found in sentences, for the page and the terminal."""

from __future__ import annotations

from stiffopt.report.common.text import listed, si
from stiffopt.sweep.summary import SweepSummary


def headline(summary: SweepSummary) -> str:
    """How many cases ended how."""
    counts = [f"{number} {name.replace('_', ' ')}" for name, number in summary.statuses().items()]
    return f"{len(summary.sweep.cases)} cases: {listed(counts)}"


def knee_sentence(summary: SweepSummary) -> str:
    """Where the trade-off front bends; "" without a front."""
    front = summary.front()
    if front is None:
        return ""
    if front.knee is None:
        return f"Fewer than three cases trade {front.over} for the objective: no knee."
    value = si(float(front.objectives[front.knee]), summary.units["objective"])
    at = f"{front.values[front.knee]:.4g} {front.unit}".rstrip()
    return f"Knee of the front: {front.over} = {at}, objective {value}."


def spread_sentence(summary: SweepSummary) -> str:
    """How far optima from several starts lie apart; "" where there is one start."""
    spreads = list(summary.spreads().values())
    if not spreads:
        return ""
    furthest = max(spreads, key=lambda each: abs(each.worst - each.best) / (abs(each.best) or 1.0))
    near = sum(each.near for each in spreads)
    usable = sum(each.usable for each in spreads)
    return (
        f"{near} of {usable} usable starts end within 1 % of the best of their case; the widest "
        f"spread is {si(furthest.best, furthest.unit)} to {si(furthest.worst, furthest.unit)}."
    )
