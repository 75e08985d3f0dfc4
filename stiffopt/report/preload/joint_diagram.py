"""Joint diagram of VDI 2230: force of bolt and clamped parts over their elongation."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiffopt.preload.bolt_sheet import BoltSheet
from stiffopt.report.common.svg import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    SKY,
    VERMILLION,
    WIDTH,
    figure_style,
)
from stiffopt.report.preload.words import readable


def joint_diagrams(sheets: Sequence[BoltSheet]) -> Figure:
    """One diagram for each flange, forces of one bolt in kN, elongations in um.

    From the left the bolt's line 1/delta_S, from the right that of the clamped parts 1/delta_P;
    they meet at the assembly preload. Drawn at its least and at its largest; the band between is
    the scatter. The working load opens the lens on the least line, where clamp load is judged.
    """
    columns = min(3, len(sheets))
    rows = -(-len(sheets) // columns)
    width = WIDTH if columns > 1 else 0.62 * WIDTH
    height = 0.85 + 2.9 * rows
    with figure_style():
        figure = Figure(figsize=(width, height))
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid[len(sheets) :]:
            axes.set_visible(False)
        for axes, sheet in zip(grid, sheets, strict=False):
            _draw_diagram(axes, sheet)
        for place, axes in enumerate(grid[: len(sheets)]):
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
    # The bolt's line is one; each preload has its own line of the clamped parts.
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
        needed, color=ORANGE, linewidth=1.0, linestyle=(0, (4, 2)), label="clamp load asked for"
    )
    axes.set_xlim(0.0, 1.04 * (bolt + plates) * largest)
    axes.set_ylim(min(0.0, service + taken - load), 1.16 * top)
    names = [("F_M max", largest), ("F_M min", least), ("F_V min", service)]
    previous = float("inf")
    for name, force in names:
        # Names that would lie on each other move apart.
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
