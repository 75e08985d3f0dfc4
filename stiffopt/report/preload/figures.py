"""Figures of a preload study: Pareto front, shares of the wind-up, loosening.

Preloads in kN, stiffness in N m/rad (prismatic joints: N/m), shares in percent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from stiffopt.preload.pareto import ParetoFront
from stiffopt.preload.sensitivity import WindupShare
from stiffopt.report.common.robot import JointUnits, element_colour
from stiffopt.report.common.svg import BLUE, GREEN, ORANGE, VERMILLION, WIDTH, figure_style, panels
from stiffopt.report.common.text import percent, significant
from stiffopt.report.preload.words import readable


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
    with figure_style():
        figure = Figure(figsize=(WIDTH * 0.62, 3.2))
        axes = figure.subplots()
        axes.plot(total, value, "o-", color=BLUE, markersize=3.5)
        knee = front.knee
        axes.plot(total[knee], value[knee], "o", color=VERMILLION, markersize=7)
        axes.annotate(
            f"knee: {significant(total[knee], 3)} kN",
            (total[knee], value[knee]),
            xytext=(10, -14),
            textcoords="offset points",
            color=VERMILLION,
            fontsize=8.5,
        )
        _level_if_flat(axes)
        axes.set_xlabel("total preload of all bolts and pins [kN]")
        axes.set_ylabel(label)
        beside = axes.secondary_yaxis("right", functions=_percent_above(float(value[0])))
        beside.set_ylabel("more than with the least preload [%]")
        beside.spines["right"].set_visible(True)
        figure.subplots_adjust(left=0.12, right=0.9)
        return figure


def _percent_above(first: float) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Return conversions of a value to per cent above `first` and back."""

    def above(value: Any) -> Any:
        return 100 * (value / first - 1)

    def back(percent: Any) -> Any:
        return first * (1 + percent / 100)

    return above, back


def _level_if_flat(axes: Axes) -> None:
    """Widen the range of a flat front, whose rounding errors would otherwise be magnified."""
    low, high = axes.get_ylim()
    middle = 0.5 * (low + high)
    if high - low < 1e-3 * abs(middle):
        axes.set_ylim(middle * (1 - 1e-3), middle * (1 + 1e-3))


def shares_figure(shares: Mapping[int, Sequence[WindupShare]], free: Sequence[str]) -> Figure:
    """Plot the share of every element in the wind-up of its joint, the most compliant first.

    `shares`: shares in one load case each. `free`: names of the elements with free preload; written
    in bold.
    """
    columns = min(3, len(shares))
    most = max(len(each) for each in shares.values())
    with figure_style():
        height = 0.5 + -(-len(shares) // columns) * _bars_height(most)
        width = WIDTH if columns > 1 else WIDTH * 0.62
        figure, grid = panels(len(shares), columns, (width, height))
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


def loosening_figure(first_slip: Mapping[str, float], slip: Mapping[str, float]) -> Figure:
    """Plot the remaining preload at which the rim of each connection slips, then all of it.

    `first_slip` and `slip`: remaining share of the least preload.
    """
    keys = list(slip)
    with figure_style():
        height = 0.75 + 0.3 * len(keys)
        figure = Figure(figsize=(WIDTH * 0.8, height))
        axes = figure.subplots()
        for row, key in enumerate(keys):
            whole, rim = (100 * min(max(each[key], 0.0), 1.0) for each in (slip, first_slip))
            rim = max(rim, whole)
            axes.barh(row, whole, color=VERMILLION, height=0.62)
            axes.barh(row, rim - whole, left=whole, color=ORANGE, height=0.62)
            axes.barh(row, 100 - rim, left=rim, color=GREEN, height=0.62, alpha=0.75)
        for colour, name in ((VERMILLION, "slips"), (ORANGE, "rim slips"), (GREEN, "holds")):
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
