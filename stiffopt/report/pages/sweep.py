"""report.html of a sweep: status of its cases, objective over varied entries, table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiffopt.report.common import svg
from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.text import scale, si, words
from stiffopt.report.pages import sweep_terminal
from stiffopt.sweep.run import is_unusable
from stiffopt.sweep.summary import Front, SweepSummary
from stiffopt.units import number_and_unit

PAGE_FILE = "report.html"
# Rows of the table on the page; table.csv has all.
_MAX_ROWS = 200
# Quantity that is plotted, by kind of the base file.
ANSWERS = {"trajectory": "objective", "preload": "objective", "recordings": "residual_after"}


def write_sweep_report(summary: SweepSummary, folder: Path) -> Path:
    """Write report.html and its figures as SVG into `folder`; return the page."""
    figures = PageFigures("sweep", png=False)
    drawn = axes_figure(summary)
    if drawn is not None:
        figures.draw("answer", drawn, "Result over the varied entries")
    front, spreads = summary.front(), summary.spreads()
    if front is not None and len(front.values) > 1:
        figures.draw("front", front_figure(front, summary.units["objective"]), "Trade-off front")
    if spreads:
        figures.draw("spread", spread_figure(summary), "Spread of the optima")
    columns = summary.columns()
    shown = [name for name in columns if name != "message"]
    rows = list(zip(*(columns[name] for name in shown), strict=True))
    context = {
        "title": f"Sweep: {summary.sweep.title}",
        "headline": sweep_terminal.headline(summary),
        "knee": sweep_terminal.knee_sentence(summary),
        "spread": sweep_terminal.spread_sentence(summary),
        "shared": sweep_terminal.shared_section(summary),
        "head": [name if name in summary.sweep.places else words(name) for name in shown],
        "rows": [
            [
                cell if isinstance(cell, str) else si(cell, summary.units.get(name, ""), 5)
                for name, cell in zip(shown, row, strict=True)
            ]
            for row in rows[:_MAX_ROWS]
        ],
        "more": max(len(rows) - _MAX_ROWS, 0),
    }
    return write_page("pages/sweep.html.j2", folder / PAGE_FILE, context, figures)


@svg.figure_style()
def axes_figure(summary: SweepSummary) -> Figure | None:
    """Plot the result over each numeric entry; None without such an entry or result."""
    name = ANSWERS[summary.sweep.kind]
    points = [
        (dict(case.changes), None if is_unusable(found) else found["values"].get(name, {}))
        for case, found in summary.done
    ]
    answers = [(own or {}).get("value") for _, own in points]
    held = np.array([np.nan if each is None else float(each) for each in answers])
    if not np.isfinite(held).any():
        return None
    drawn = {}
    for place in summary.sweep.places:
        numbers = [number_and_unit(changes[place]) for changes, _ in points]
        units = {unit for _, unit in numbers}
        if None not in units and len(units) == 1 and len(set(numbers)) > 1:
            drawn[place] = (np.array([value for value, _ in numbers]), numbers[0][1] or "SI")
    if not drawn:
        return None
    factor, unit = scale(float(np.nanmax(np.abs(held))), summary.units[name])
    columns = min(3, len(drawn))
    size = svg.WIDTH, 0.9 + 2.4 * -(-len(drawn) // columns)
    figure, grid = svg.panels(len(drawn), columns, size, sharey=True)
    lost = ~np.isfinite(held)
    for axes, (place, (values, kind)) in zip(grid, drawn.items(), strict=True):
        _draw_curves(axes, summary, place, values, factor * held)
        floor = np.full(lost.sum(), factor * np.nanmin(held))
        axes.plot(values[lost], floor, "x", color=svg.VERMILLION, markersize=5.0)
        axes.set_xlabel(f"{place} [{kind}]")
    for axes in grid[::columns]:
        axes.set_ylabel(f"{words(name)} [{unit}]" if unit else words(name))
    figure.tight_layout()
    return figure


def _draw_curves(
    axes: Axes, summary: SweepSummary, place: str, values: np.ndarray, held: np.ndarray
) -> None:
    """Plot results over one entry; a line joins cases that share all others, at their best start.

    `values`, `held` (n,): entry and result of each finished case.
    """
    curves: dict[tuple[str, ...], list[int]] = {}
    for index, (case, _) in enumerate(summary.done):
        others = (f"{name} = {value}" for name, value in case.changes if name != place)
        bases = [summary.sweep.base_names[case.base]] * (len(summary.sweep.base_names) > 1)
        curves.setdefault((*bases, *others), []).append(index)
    # Longer keys than one entry would cover the curves.
    told = 1 < len(curves) <= min(len(svg.PALETTE), len(held) - 1) and all(
        len(names) == 1 for names in curves
    )
    cost = -held if summary.maximised else held
    for index, (names, members) in enumerate(curves.items()):
        style = svg.line_style(index) if told else {"color": svg.BLUE, "linestyle": "-"}
        own = np.array(members)
        axes.plot(values[own], held[own], "o", color=style["color"], markersize=3.5, alpha=0.7)
        own = own[np.lexsort((cost[own], values[own]))]
        best = own[np.unique(values[own], return_index=True)[1]]
        axes.plot(values[best], held[best], label=" ".join(names), linewidth=1.0, **style)
    if told:
        axes.legend()


@svg.figure_style()
def front_figure(front: Front, unit: str) -> Figure:
    """Plot the Pareto front with its knee."""
    factor, shown = scale(float(np.abs(front.objectives).max()), unit)
    figure, axes = svg.subplots(3.2)
    axes.plot(front.values, factor * front.objectives, "o-", color=svg.BLUE, markersize=4.0)
    if front.knee is not None:
        at, value = front.values[front.knee], factor * front.objectives[front.knee]
        axes.plot([at], [value], "o", color=svg.VERMILLION, markersize=8.0)
        axes.annotate("knee", (at, value), (6, 6), textcoords="offset points")
    axes.set_xlabel(f"{front.over} [{front.unit}]" if front.unit else front.over)
    axes.set_ylabel(f"objective [{shown}]" if shown else "objective")
    figure.tight_layout()
    return figure


@svg.figure_style()
def spread_figure(summary: SweepSummary) -> Figure:
    """Plot the worst over the best optimum of each case among its starts."""
    spreads = summary.spreads()
    figure, axes = svg.subplots(3.0)
    ratios = [each.worst / each.best for each in spreads.values() if each.best]
    axes.bar(np.arange(1, len(ratios) + 1), ratios, color=svg.GREY, width=0.7)
    axes.axhline(1.0, color=svg.BLUE)
    axes.set_xlabel("case")
    axes.set_ylabel("worst over best optimum")
    figure.tight_layout()
    return figure
