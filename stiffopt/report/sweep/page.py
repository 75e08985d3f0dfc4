"""report.html of a sweep: how its cases ended, the answer over what varies, the table."""

from __future__ import annotations

from pathlib import Path

from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.text import si, words
from stiffopt.report.sweep.figures import axes_figure, front_figure, spread_figure
from stiffopt.report.sweep.sentences import headline, knee_sentence, spread_sentence
from stiffopt.sweep.summary import Cell, SweepSummary

PAGE_FILE = "report.html"
# Of the table on the page; table.csv has all.
_MAX_ROWS = 200


def write_sweep_report(summary: SweepSummary, folder: Path) -> Path:
    """Write report.html and its figures as SVG into `folder`; return the page."""
    figures = PageFigures("sweep", png=False)
    drawn = axes_figure(summary)
    if drawn is not None:
        figures.draw("answer", drawn, "The answer over what varies")
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
        "headline": headline(summary),
        "knee": knee_sentence(summary),
        "spread": spread_sentence(summary),
        "head": [name if name in summary.sweep.places else words(name) for name in shown],
        "rows": [
            [
                _format_cell(cell, summary.units.get(name, ""))
                for name, cell in zip(shown, row, strict=True)
            ]
            for row in rows[:_MAX_ROWS]
        ],
        "more": max(len(rows) - _MAX_ROWS, 0),
    }
    return write_page("sweep/page.html.j2", folder / PAGE_FILE, context, figures)


def _format_cell(cell: Cell, unit: str) -> str:
    return cell if isinstance(cell, str) else si(cell, unit, 5)
