"""Motions whose motors lead the links, on arms as they may be: table, figure, words."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stiffopt.report.common.svg import BLUE, GREY, VERMILLION, WIDTH, figure_style
from stiffopt.report.common.text import listed, scale, si, significant
from stiffopt.result.compensation import CompensatedMotion, Compensation, Spread, Spreads
from stiffopt.result.compensation_store import COMMAND_FILE

_PLANNED_LABEL, _COMPENSATED_LABEL = "as planned", "compensated"
# What its figure shows, for those who do not see it.
COMPENSATED = "Peak deviations on uncertain arms, as planned and compensated"
# Dots of draws are spread over this height of a row.
_DOT_SPREAD = 0.25


def compensation_table(compensation: Compensation) -> tuple[list[str], list[list[str]]]:
    """Head and rows of text, two rows a motion."""
    head = ["motion", "motors"]
    for phase in ("in flight", "after"):
        head += [f"{phase}, nominal", "90 % of draws", "worst"]
    head += ["worst arm in flight", "motor limits"]
    rows = []
    for motion in compensation.motions:
        for how, spreads in (
            (_PLANNED_LABEL, motion.planned),
            (_COMPENSATED_LABEL, motion.compensated),
        ):
            cells = [
                motion.name,
                how,
                *_spread_cells(spreads.flight),
                *_spread_cells(spreads.after),
            ]
            rows.append([*cells, spreads.flight.worst_case, _limit_cell(motion, how)])
    return head, rows


def _spread_cells(spread: Spread) -> list[str]:
    return [si(value, "m", 3) for value in (spread.nominal, spread.quantile(0.9), spread.worst)]


def _limit_cell(motion: CompensatedMotion, how: str) -> str:
    if how == _PLANNED_LABEL:
        return "–"
    return f"exceeds {motion.excess[0].describe()}" if motion.excess else "kept"


def compensation_section(compensation: Compensation | None) -> dict[str, Any] | None:
    """Text, table and notes, as pages have them; None where nothing was compensated."""
    if compensation is None:
        return None
    return {
        "file": compensation.file,
        "text": compensation_text(compensation),
        "table": compensation_table(compensation),
        "notes": compensation_notes(compensation),
    }


def compensation_text(compensation: Compensation) -> str:
    """What the command gives, nominally and at worst, against toppra's motion."""
    if compensation.refusal:
        return compensation.refusal
    own = compensation.optimised
    text = (
        f"Commanded as {compensation.file or COMMAND_FILE}, the elastic arm's tool is within "
        f"{_format_deviations(own.compensated)} of the plan in flight and after arrival, at worst within "
        f"{_format_deviations(own.compensated, True)}"
    )
    other = next((each for each in compensation.motions if each.name == "toppra"), None)
    if other is None:
        return f"{text}."
    plain, led = other.planned, other.compensated
    return (
        f"{text}; toppra's motion as planned {_format_deviations(plain)}, at worst {_format_deviations(plain, True)}, with "
        f"the same compensation {_format_deviations(led)} and {_format_deviations(led, True)}. That is "
        f"{_compare_deviations(plain, own.compensated)} toppra as planned, at worst "
        f"{_compare_deviations(plain, own.compensated, True)} it, and {_compare_deviations(led, own.compensated, True)} it "
        "compensated, at worst."
    )


def _format_deviations(spreads: Spreads, worst: bool = False) -> str:
    values = [s.worst if worst else s.nominal for s in (spreads.flight, spreads.after)]
    return " / ".join(si(value, "m", 2) for value in values)


def _compare_deviations(other: Spreads, own: Spreads, worst: bool = False) -> str:
    """How far below the other, in flight and after arrival: "8.5 / 5.7 times below"."""
    phases = ((other.flight, own.flight), (other.after, own.after))
    pairs = [[s.worst if worst else s.nominal for s in pair] for pair in phases]
    (flight, first), (after, second) = (_compare_sizes(theirs, ours) for theirs, ours in pairs)
    if first == second:
        return f"{flight} / {after} {first}" if flight else first
    return f"in flight {flight} {first} and after arrival {after} {second}".replace("  ", " ")


def _compare_sizes(theirs: float, ours: float) -> tuple[str, str]:
    """Ratio of two sizes, "" where there is none, and what it means: ("8.5", "times below")."""
    if not np.isfinite([theirs, ours]).all():
        return "", "not comparable with"
    if theirs == ours:
        return "", "equal to"
    if 0.0 in (theirs, ours):
        return "", "above the 0 of" if theirs == 0.0 else "at 0, below"
    ratio = significant(max(theirs / ours, ours / theirs), 2)
    if ratio == significant(1.0, 2):
        return "", "about equal to"
    return ratio, "times below" if theirs > ours else "times above"


def compensation_notes(compensation: Compensation) -> list[str]:
    """What was taken as uncertain, and how the command was made."""
    own = compensation.optimised
    made = (
        "The plan is smooth enough as it is"
        if own.spacing is None
        else f"Splines with knots every {si(own.spacing, 's', 2)} smooth the plan"
    )
    loop = compensation.loop
    return [
        *([f"Every arm's motors follow by position loops of {loop}."] if loop else []),
        f"Uncertain: {listed(compensation.uncertainty)}. The worst arm has each at a bound, or the "
        f"joints' stiffness such that their errors add up; {compensation.draws} arms are drawn "
        "evenly between the bounds. The problem's limits, settling included, are judged on the arm "
        "as modelled only.",
        f"{made}; the motors lead by {100 * own.share:.0f} % of the nominal wind-up, "
        f"{'as chosen by the solve' if compensation.file else 'which is best for the worst arm'}.",
    ]


def compensation_figure(compensation: Compensation) -> Figure:
    """Peaks on all drawn arms, nominal and worst, in flight and after arrival."""
    rows = [
        (f"{motion.name}, {how}", color, spreads)
        for motion in compensation.motions
        for how, color, spreads in (
            (_PLANNED_LABEL, VERMILLION, motion.planned),
            (_COMPENSATED_LABEL, BLUE, motion.compensated),
        )
    ]
    sizes = [s.worst for _, _, each in rows for s in (each.flight, each.after)]
    factor, unit = scale(max(sizes), "m")
    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.9 + 0.42 * len(rows)))
        panels = figure.subplots(1, 2, sharey=True)
        for axes, phase in zip(panels, ("flight", "after"), strict=True):
            for place, (_, color, spreads) in enumerate(rows):
                spread: Spread = getattr(spreads, phase)
                height = place + _DOT_SPREAD * np.linspace(-1.0, 1.0, len(spread.draws))
                axes.plot(factor * spread.draws, height, ".", color=color, alpha=0.4, markersize=4)
                axes.plot(factor * spread.nominal, place, "D", color=color, markersize=6)
                axes.plot(factor * spread.worst, place, "|", color=color, markersize=16)
            if any(getattr(each, phase).worst > 0.0 for _, _, each in rows):
                axes.set_xscale("log")
            axes.grid(axis="x", color=GREY, linewidth=0.4)
            where = "in flight" if phase == "flight" else "after arrival"
            axes.set_xlabel(f"peak deviation {where} [{unit}]")
        panels[0].set_yticks(range(len(rows)), [name for name, _, _ in rows])
        panels[0].invert_yaxis()
        figure.subplots_adjust(left=0.19, right=0.99, wspace=0.06)
        return figure
