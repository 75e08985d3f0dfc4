"""Drawing of each flange: its ring, its bolts, and what each of them carries."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Circle

from stiffopt.drivetrain import catalogue
from stiffopt.preload.bolt_sheet import BoltSheet
from stiffopt.report.common.svg import BLUE, GREY, INK, PALE, VERMILLION, WIDTH, figure_style
from stiffopt.report.common.text import significant
from stiffopt.report.preload.words import readable


def flange_drawings(sheets: Sequence[BoltSheet]) -> Figure:
    """Flanges in their load case of the most clamp load, one scale each.

    Beside each bolt its axial load in N, above 0 where it is pulled; arrows are its transverse
    load, the longest as long as half the bolt circle's radius.
    """
    columns = min(3 if len(sheets) != 4 else 4, len(sheets))
    rows = -(-len(sheets) // columns)
    side = WIDTH / columns if columns > 1 else 0.45 * WIDTH
    width, height = side * columns, (side + 0.35) * rows
    with figure_style():
        figure = Figure(figsize=(width, height))
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid:
            axes.set_axis_off()
        for axes, sheet in zip(grid, sheets, strict=False):
            _draw_flange(axes, sheet)
        figure.subplots_adjust(
            left=0.01, right=0.99, bottom=0.02, top=1 - 0.32 / height, wspace=0.05, hspace=0.16
        )
        return figure


def _draw_flange(axes: Axes, sheet: BoltSheet) -> None:
    flange = sheet.flange
    assert flange.bolt is not None
    outer, inner = 1e3 * flange.outer_radius, 1e3 * flange.inner_radius
    circle = 1e3 * flange.circle_diameter / 2
    head = 1e3 * catalogue.bolt(flange.bolt.size).head_diameter / 2
    axes.add_patch(Annulus((0, 0), outer, outer - inner, facecolor=PALE, edgecolor=GREY, lw=0.8))
    axes.add_patch(Circle((0, 0), circle, fill=False, edgecolor=GREY, lw=0.6, ls=(0, (6, 2, 1, 2))))
    longest = float(np.linalg.norm(sheet.transverse, axis=1).max())
    for angle, axial, across in zip(sheet.angles, sheet.axial, sheet.transverse, strict=True):
        x, y = circle * np.cos(angle), circle * np.sin(angle)
        pulled = axial > 1e-9 * max(longest, 1.0)
        axes.add_patch(
            Circle((x, y), head, facecolor="white", edgecolor=VERMILLION if pulled else INK, lw=1.1)
        )
        if longest > 0.0:
            arrow = 0.5 * circle * across / longest
            axes.annotate(
                "",
                (x + arrow[0], y + arrow[1]),
                (x, y),
                arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 1.1, "shrinkA": 0},
            )
        far = outer + 0.16 * outer
        axes.text(
            far * np.cos(angle),
            far * np.sin(angle),
            "0" if abs(axial) < 0.05 else significant(float(axial), 3),
            ha="center",
            va="center",
            fontsize=7.5,
            color=VERMILLION if pulled else INK,
        )
    axes.text(
        0, 0, f"{significant(longest, 3)} N\nacross, most", ha="center", va="center", fontsize=7.0,
        color=BLUE,
    )  # fmt: skip
    reach = 1.36 * outer
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.set_title(f"{readable(sheet.key).capitalize()}: {sheet.case}", fontsize=8.5)
