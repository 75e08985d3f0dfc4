"""Compensated motions on uncertain arms: table, figure and sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.report.common.terminal import ReportSection
from stiffopt.report.common.text import DASH, listed, scale, si, significant
from stiffopt.report.solve.wording import rival_text
from stiffopt.result.compensation import (
    COMMAND_FILE,
    CompensatedMotion,
    Compensation,
    RivalComparison,
    Spread,
    Spreads,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PLANNED_LABEL, _COMPENSATED_LABEL = "as planned", "compensated"
# Text alternative of the figure.
COMPENSATED = "Peak deviations on uncertain arms, as planned and compensated"


def compensation_section(compensation: Compensation) -> ReportSection:
    """Return the peak deviations, two rows per motion, and notes on uncertainty and command.

    A slower rival that is better in an error is followed by the optimised motion at its duration.
    """
    head = ["motion", "duration", "motors"]
    for phase in ("in flight", "after"):
        head += [f"{phase}, nominal", "90 % of draws", "worst"]
    head += ["optimised over it", "motor limits"]
    beside = {each.rival.name: each for each in compensation.beside_rivals}
    spreads = [s for m in compensation.motions for s in (m.planned, m.compensated)]
    factor, unit = scale(max(each.worst for s in spreads for each in (s.flight, s.after)), "m")
    rows = []
    for motion in compensation.motions:
        found = beside.get(motion.name)
        rows += _motion_rows(motion, motion.name, factor, found)
        if found is not None and found.own is not compensation.optimised:
            rows += _motion_rows(found.own, "optimised, slowed", factor)[1:]
    return ReportSection(
        title=f"Deviations [{unit}] on uncertain arms, as planned and compensated",
        head=head,
        rows=rows,
        lines=_compensation_notes(compensation),
        numbers=[head[1], *head[3:-2]],
    )


def _motion_rows(
    motion: CompensatedMotion, name: str, factor: float, beside: RivalComparison | None = None
) -> list[list[str]]:
    """Return the rows of a motion as planned and with its command."""
    ratios = {} if beside is None else beside.ratios
    over = " / ".join(significant(each, 3) for each in ratios.values()) or DASH
    return [
        [
            name,
            si(motion.duration, "s", 4),
            how,
            *_spread_cells(spreads.flight, factor),
            *_spread_cells(spreads.after, factor),
            over if how == _COMPENSATED_LABEL else DASH,
            _limit_cell(motion, how),
        ]
        for how, spreads in (
            (_PLANNED_LABEL, motion.planned),
            (_COMPENSATED_LABEL, motion.compensated),
        )
    ]


def _spread_cells(spread: Spread, factor: float) -> list[str]:
    values = (spread.nominal, spread.quantile(0.9), spread.worst)
    return [significant(factor * value, 3) for value in values]


def _limit_cell(motion: CompensatedMotion, how: str) -> str:
    if how == _PLANNED_LABEL:
        return DASH
    return f"exceeds {motion.excess[0].describe()}" if motion.excess else "kept"


def compensation_text(compensation: Compensation) -> str:
    """Return a sentence on nominal and worst deviations, or why there is no command."""
    if compensation.refusal:
        return compensation.refusal
    own = compensation.optimised
    return (
        f"With the command {compensation.file or COMMAND_FILE} the elastic arm's tool deviates "
        f"from the plan by at most {_format_deviations(own.compensated)} in flight / after "
        f"arrival, in the worst case {_format_deviations(own.compensated, True)}."
    )


def _format_deviations(spreads: Spreads, worst: bool = False) -> str:
    values = [s.worst if worst else s.nominal for s in (spreads.flight, spreads.after)]
    return " / ".join(si(value, "m", 2) for value in values)


def _compensation_notes(compensation: Compensation) -> list[str]:
    """Return notes on the uncertainties and on the computation of the command."""
    own = compensation.optimised
    made = (
        "The plan needs no smoothing"
        if own.spacing is None
        else f"Splines with knots every {si(own.spacing, 's', 2)} smooth the plan"
    )
    loop = compensation.loop
    # A stored command is not slowed.
    slowed = "" if compensation.file else "; slowed beside a slower rival that is better in one"
    return [
        *([f"The motors of every arm follow in position loops of {loop}."] if loop else []),
        f"Uncertain: {listed(compensation.uncertainty)}. The worst"
        " case is the worst arm that an exchange of the values at their bounds finds; "
        f"{compensation.draws} arms are drawn uniformly within the bounds. The problem's limits, "
        "settling included, are checked on the nominal arm only.",
        f"Worst arm of the optimised motion in flight: {own.compensated.flight.worst_case}.",
        "Optimised motion over a rival: worst errors in flight / after arrival / across the path "
        f"in flight{slowed}.",
        f"{made}; the feedforward lead is {100 * own.share:.0f} % of the nominal wind-up, "
        f"{'as chosen by the solve' if compensation.file else 'chosen for the worst case'}.",
    ]


# Filters of pages that show compensated motions.
COMPENSATION_FILTERS = {
    function.__name__: function
    for function in (compensation_text, compensation_section, rival_text)
}


def compensation_figure(compensation: Compensation) -> Figure:
    """Plot peak deviations of all sampled arms, in flight and after arrival."""
    # matplotlib loads slowly, and the texts do without it.
    from matplotlib.figure import Figure

    from stiffopt.report.common import svg

    rows = [
        (f"{motion.name}, {how}", color, spreads)
        for motion in compensation.motions
        for how, color, spreads in (
            (_PLANNED_LABEL, svg.VERMILLION, motion.planned),
            (_COMPENSATED_LABEL, svg.BLUE, motion.compensated),
        )
    ]
    sizes = [s.worst for _, _, each in rows for s in (each.flight, each.after)]
    factor, unit = scale(max(sizes), "m")
    with svg.figure_style():
        figure = Figure(figsize=(svg.WIDTH, 0.9 + 0.42 * len(rows)))
        panels = figure.subplots(1, 2, sharey=True)
        for axes, phase in zip(panels, ("flight", "after"), strict=True):
            for place, (_, color, spreads) in enumerate(rows):
                spread: Spread = getattr(spreads, phase)
                # Half height over which the dots of a row are spread.
                height = place + 0.25 * np.linspace(-1.0, 1.0, len(spread.draws))
                axes.plot(factor * spread.draws, height, ".", color=color, alpha=0.4, markersize=4)
                axes.plot(factor * spread.nominal, place, "D", color=color, markersize=6)
                axes.plot(factor * spread.worst, place, "|", color=color, markersize=16)
            if any(getattr(each, phase).worst > 0.0 for _, _, each in rows):
                svg.set_log_scale(axes, "x")
            axes.grid(axis="x", color=svg.GREY, linewidth=0.4)
            where = "in flight" if phase == "flight" else "after arrival"
            axes.set_xlabel(f"peak deviation {where} [{unit}]")
        panels[0].set_yticks(range(len(rows)), [name for name, _, _ in rows])
        panels[0].invert_yaxis()
        figure.subplots_adjust(left=0.19, right=0.99, wspace=0.06)
        return figure
