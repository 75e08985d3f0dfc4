"""Figures of bolts: joint diagrams of VDI 2230, and flanges with the load of each bolt."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Circle

from stiffopt.drivetrain import catalogue
from stiffopt.preload.bolt_sheet import BoltSheet
from stiffopt.report.common.svg import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    SKY,
    VERMILLION,
    WIDTH,
    figure_style,
    panels,
)
from stiffopt.report.common.text import significant
from stiffopt.report.preload.words import readable


def joint_diagrams(sheets: Sequence[BoltSheet]) -> Figure:
    """Draw a joint diagram for each flange, forces of one bolt in kN, elongations in um.

    The bolt's line 1/delta_S rises from the left, that of the clamped parts 1/delta_P from the
    right; they meet at the assembly preload, drawn at its largest value and at the least in
    service. The working load is drawn at the latter, which determines the clamp load.
    """
    columns = min(3, len(sheets))
    width = WIDTH if columns > 1 else 0.62 * WIDTH
    height = 0.85 + 2.9 * -(-len(sheets) // columns)
    with figure_style():
        figure, grid = panels(len(sheets), columns, (width, height))
        for place, (axes, sheet) in enumerate(zip(grid, sheets, strict=True)):
            _draw_diagram(axes, sheet)
            if place % columns == 0:
                axes.set_ylabel("force of one bolt [kN]")
            axes.set_xlabel("elongation [µm]")
        handles, labels = grid[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="lower left", ncols=3, bbox_to_anchor=(0.06, 0.0))
        figure.subplots_adjust(
            left=0.6 / width,
            right=0.99,
            top=1 - 0.3 / height,
            bottom=1.05 / height,
            wspace=0.2,
            hspace=0.5,
        )
        return figure


def _draw_diagram(axes: Axes, sheet: BoltSheet) -> None:
    bolt, plates = 1e6 * sheet.bolt_compliance, 1e6 * sheet.plate_compliance
    largest, least = sheet.largest / 1e3, sheet.least / 1e3
    service = max(sheet.in_service, 0.0) / 1e3
    bolt, plates = 1e3 * bolt, 1e3 * plates  # um per kN
    # One line of the bolt; a line of the clamped parts for each preload.
    end = bolt * largest
    axes.axhspan(least, largest, color=SKY, alpha=0.25, linewidth=0, zorder=0, label="scatter")
    axes.plot([0, end], [0, largest], color=BLUE, label="bolt, 1/δS")
    for force, style in ((largest, "-"), (service, (0, (5, 1.5)))):
        axes.plot(
            [bolt * force, (bolt + plates) * force],
            [force, 0],
            color=GREEN,
            linestyle=style,
            label="clamped parts, 1/δP" if force == largest else "the same, least in service",
        )
    axes.axhline(service, color=GREY, linewidth=0.8, linestyle=(0, (1.5, 1.2)))
    load = sheet.working_load / 1e3
    taken = sheet.factor_most * load
    top = max(largest, service + taken)
    if load > 0.0:
        at = bolt * (service + taken)
        axes.plot(
            [at, at],
            [service + taken - load, service + taken],
            color=VERMILLION,
            linewidth=2.4,
            label="working load F_A",
        )
    needed = sheet.clamp_needed / 1e3
    axes.axhline(
        needed, color=ORANGE, linewidth=1.0, linestyle=(0, (4, 2)), label="required clamp load"
    )
    axes.set_xlim(0.0, 1.04 * (bolt + plates) * largest)
    axes.set_ylim(min(0.0, service + taken - load), 1.16 * top)
    names = [("F_M max", largest), ("F_M min", least), ("F_V min", service)]
    previous = float("inf")
    for name, force in names:
        # Overlapping labels are moved apart.
        place = min(force, previous - 0.055 * top)
        axes.annotate(
            f"{name} {force:.3g}",
            (0.012, place),
            xycoords=("axes fraction", "data"),
            ha="left",
            va="bottom",
            fontsize=7.5,
            color=INK,
        )
        previous = place
    axes.set_title(readable(sheet.key).capitalize())
    axes.locator_params(axis="x", nbins=6)


def flange_drawings(sheets: Sequence[BoltSheet]) -> Figure:
    """Draw each flange in the load case that requires the largest clamp load, each to its scale.

    Numbers are axial loads of bolts in N, positive in tension; arrows are transverse loads, the
    longest half the radius of the bolt circle.
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
    largest = f"{significant(longest, 3)} N\ntransverse, max."
    axes.text(0, 0, largest, ha="center", va="center", fontsize=7.0, color=BLUE)
    reach = 1.36 * outer
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.set_title(f"{readable(sheet.key).capitalize()}: {sheet.case}", fontsize=8.5)
