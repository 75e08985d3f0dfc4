"""Figures of a preload study: Pareto front, shares of the wind-up, loosening, bolts and flanges.

Preloads in kN, stiffness in N m/rad (prismatic joints: N/m), shares in percent. Bolts have joint
diagrams of VDI 2230; flanges show the load of each bolt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Circle
from matplotlib.ticker import FuncFormatter

from stiffopt.drivetrain import catalogue
from stiffopt.preload.bolt_sheet import BoltSheet
from stiffopt.preload.pareto import ParetoFront
from stiffopt.preload.sensitivity import WindupShare
from stiffopt.report.common import svg
from stiffopt.report.common.robot import JointUnits, element_colour
from stiffopt.report.common.text import percent, significant
from stiffopt.report.preload.words import readable


@svg.figure_style()
def front_figure(front: ParetoFront, units: Sequence[JointUnits], joints: Sequence[int]) -> Figure:
    """Plot the Pareto front of total preload and stiffness with its knee.

    `joints`: with one joint its stiffness is plotted, with several the least relative stiffness.
    """
    total = np.array([point.total_preload for point in front.points]) / 1e3
    if len(joints) == 1:
        value = np.array([point.stiffness[0] for point in front.points])
        label = f"least stiffness of joint {joints[0]} [{units[joints[0] - 1].stiffness}]"
    else:
        value = 100 * np.array([point.level for point in front.points])
        label = "least relative stiffness of any joint [%]"
    figure, axes = svg.subplots(3.2, width=svg.WIDTH * 0.62)
    axes.plot(total, value, "o-", color=svg.BLUE, markersize=3.5)
    knee = front.knee
    axes.plot(total[knee], value[knee], "o", color=svg.VERMILLION, markersize=7)
    axes.annotate(
        f"knee: {significant(total[knee], 3)} kN",
        (total[knee], value[knee]),
        xytext=(10, -14),
        textcoords="offset points",
        color=svg.VERMILLION,
        fontsize=8.5,
    )
    _level_if_flat(axes)
    axes.set_xlabel("total preload of all bolts and pins [kN]")
    axes.set_ylabel(label)
    least = float(value[0])
    beside = axes.secondary_yaxis(
        "right",
        functions=(lambda x: 100 * (x / least - 1), lambda share: least * (1 + share / 100)),
    )
    beside.set_ylabel("more than with the least preload [%]")
    beside.spines["right"].set_visible(True)
    figure.subplots_adjust(left=0.12, right=0.9)
    return figure


def _level_if_flat(axes: Axes) -> None:
    """Widen the range of a flat front, whose rounding errors would otherwise be magnified."""
    low, high = axes.get_ylim()
    middle = 0.5 * (low + high)
    if high - low < 1e-3 * abs(middle):
        axes.set_ylim(middle * (1 - 1e-3), middle * (1 + 1e-3))


@svg.figure_style()
def shares_figure(shares: Mapping[int, Sequence[WindupShare]], free: Sequence[str]) -> Figure:
    """Plot the share of every element in the wind-up of its joint, the most compliant first.

    `shares`: shares in one load case each. `free`: names of the elements with free preload; written
    in bold.
    """
    columns = min(3, len(shares))
    most = max(len(each) for each in shares.values())
    height = 0.5 + -(-len(shares) // columns) * _bars_height(most)
    width = svg.WIDTH if columns > 1 else svg.WIDTH * 0.62
    figure, grid = svg.panels(len(shares), columns, (width, height))
    for place, (axes, (joint, own)) in enumerate(zip(grid, shares.items(), strict=True)):
        ordered = sorted(own, key=lambda each: -each.share)
        for row, each in enumerate(ordered):
            colour = element_colour(each.kind)
            axes.barh(row, 100 * each.share, height=0.7, color=colour)
            axes.annotate(
                percent(each.share),
                (100 * each.share, row),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
            )
        axes.set_yticks(range(len(ordered)), [readable(each.element) for each in ordered])
        for label, each in zip(axes.get_yticklabels(), ordered, strict=True):
            label.set_fontweight("bold" if each.element in free else "normal")
        axes.set_ylim(most - 0.4, -0.6)
        axes.set_xlim(0.0, 118.0)
        axes.set_xticks([0, 25, 50, 75, 100])
        axes.grid(visible=False, axis="y")
        axes.tick_params(axis="y", length=0)
        axes.set_title(f"Joint {joint}, {own[0].case}")
        if place + columns >= len(shares):
            axes.set_xlabel("share of the wind-up [%]")
    figure.subplots_adjust(
        left=0.13 if columns > 1 else 0.25,
        right=0.99,
        bottom=0.45 / height,
        top=1 - 0.3 / height,
        wspace=0.62,
        hspace=0.5 / (_bars_height(most) - 0.5),
    )
    return figure


def _bars_height(bars: int) -> float:
    return 0.62 + 0.23 * bars


@svg.figure_style()
def loosening_figure(first_slip: Mapping[str, float], slip: Mapping[str, float]) -> Figure:
    """Plot the remaining preload at which the rim of each connection slips, then all of it.

    `first_slip` and `slip`: remaining share of the least preload.
    """
    keys = list(slip)
    height = 0.75 + 0.3 * len(keys)
    figure, axes = svg.subplots(height, width=svg.WIDTH * 0.8)
    for row, key in enumerate(keys):
        whole, rim = (100 * min(max(each[key], 0.0), 1.0) for each in (slip, first_slip))
        rim = max(rim, whole)
        axes.barh(row, whole, color=svg.VERMILLION, height=0.62)
        axes.barh(row, rim - whole, left=whole, color=svg.ORANGE, height=0.62)
        axes.barh(row, 100 - rim, left=rim, color=svg.GREEN, height=0.62, alpha=0.75)
    for colour, name in (
        (svg.VERMILLION, "slips"),
        (svg.ORANGE, "rim slips"),
        (svg.GREEN, "holds"),
    ):
        axes.barh(0, 0, color=colour, label=name)
    axes.set_yticks(range(len(keys)), [readable(key) for key in keys])
    axes.set_ylim(len(keys) - 0.4, -0.6)
    axes.set_xlim(0.0, 100.0)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} %"))
    axes.set_xlabel("remaining share of the least preload after tightening")
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    figure.legend(loc="lower left", bbox_to_anchor=(0.24, 0.0), ncols=3, borderaxespad=0.0)
    figure.subplots_adjust(left=0.24, right=0.97, bottom=0.68 / height, top=1 - 0.05 / height)
    return figure


@svg.figure_style()
def joint_diagrams(sheets: Sequence[BoltSheet]) -> Figure:
    """Draw a joint diagram for each flange, forces of one bolt in kN, elongations in um.

    The bolt's line 1/delta_S rises from the left, that of the clamped parts 1/delta_P from the
    right; they meet at the assembly preload, drawn at its largest value and at the least in
    service. The working load is drawn at the latter, which determines the clamp load.
    """
    columns = min(3, len(sheets))
    width = svg.WIDTH if columns > 1 else 0.62 * svg.WIDTH
    height = 0.85 + 2.9 * -(-len(sheets) // columns)
    figure, grid = svg.panels(len(sheets), columns, (width, height))
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
    axes.axhspan(least, largest, color=svg.SKY, alpha=0.25, linewidth=0, zorder=0, label="scatter")
    axes.plot([0, end], [0, largest], color=svg.BLUE, label="bolt, 1/δS")
    for force, style in ((largest, "-"), (service, (0, (5, 1.5)))):
        axes.plot(
            [bolt * force, (bolt + plates) * force],
            [force, 0],
            color=svg.GREEN,
            linestyle=style,
            label="clamped parts, 1/δP" if force == largest else "the same, least in service",
        )
    axes.axhline(service, color=svg.GREY, linewidth=0.8, linestyle=(0, (1.5, 1.2)))
    load = sheet.working_load / 1e3
    taken = sheet.factor_most * load
    top = max(largest, service + taken)
    if load > 0.0:
        at = bolt * (service + taken)
        axes.plot(
            [at, at],
            [service + taken - load, service + taken],
            color=svg.VERMILLION,
            linewidth=2.4,
            label="working load F_A",
        )
    needed = sheet.clamp_needed / 1e3
    axes.axhline(
        needed, color=svg.ORANGE, linewidth=1.0, linestyle=(0, (4, 2)), label="required clamp load"
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
            color=svg.INK,
        )
        previous = place
    axes.set_title(readable(sheet.key).capitalize())
    axes.locator_params(axis="x", nbins=6)


@svg.figure_style()
def flange_drawings(sheets: Sequence[BoltSheet]) -> Figure:
    """Draw each flange in the load case that requires the largest clamp load, each to its scale.

    Numbers are axial loads of bolts in N, positive in tension; arrows are transverse loads, the
    longest half the radius of the bolt circle.
    """
    columns = min(3 if len(sheets) != 4 else 4, len(sheets))
    side = svg.WIDTH / columns if columns > 1 else 0.45 * svg.WIDTH
    height = (side + 0.35) * -(-len(sheets) // columns)
    figure, grid = svg.panels(len(sheets), columns, (side * columns, height))
    for axes, sheet in zip(grid, sheets, strict=True):
        axes.set_axis_off()
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
    axes.add_patch(
        Annulus((0, 0), outer, outer - inner, facecolor=svg.PALE, edgecolor=svg.GREY, lw=0.8)
    )
    axes.add_patch(
        Circle((0, 0), circle, fill=False, edgecolor=svg.GREY, lw=0.6, ls=(0, (6, 2, 1, 2)))
    )
    longest = float(np.linalg.norm(sheet.transverse, axis=1).max())
    for angle, axial, across in zip(sheet.angles, sheet.axial, sheet.transverse, strict=True):
        x, y = circle * np.cos(angle), circle * np.sin(angle)
        pulled = axial > 1e-9 * max(longest, 1.0)
        axes.add_patch(
            Circle(
                (x, y),
                head,
                facecolor="white",
                edgecolor=svg.VERMILLION if pulled else svg.INK,
                lw=1.1,
            )
        )
        if longest > 0.0:
            arrow = 0.5 * circle * across / longest
            axes.annotate(
                "",
                (x + arrow[0], y + arrow[1]),
                (x, y),
                arrowprops={"arrowstyle": "-|>", "color": svg.BLUE, "lw": 1.1, "shrinkA": 0},
            )
        far = outer + 0.16 * outer
        axes.text(
            far * np.cos(angle),
            far * np.sin(angle),
            "0" if abs(axial) < 0.05 else significant(float(axial), 3),
            ha="center",
            va="center",
            fontsize=7.5,
            color=svg.VERMILLION if pulled else svg.INK,
        )
    largest = f"{significant(longest, 3)} N\ntransverse, max."
    axes.text(0, 0, largest, ha="center", va="center", fontsize=7.0, color=svg.BLUE)
    reach = 1.36 * outer
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.set_title(f"{readable(sheet.key).capitalize()}: {sheet.case}", fontsize=8.5)
