"""Figures of a preload study: stiffness against preload, Pareto front, wind-up, loosening.

Each function returns a figure in the house style. Preloads in kN, stiffness in N m/rad (prismatic
joints: N/m), shares in percent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from stiffopt.report.elements import ELEMENT_COLOURS
from stiffopt.report.motions import JointUnits
from stiffopt.report.preload_wording import spoken
from stiffopt.report.quantities import significant
from stiffopt.report.svg import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    SKY,
    VERMILLION,
    WIDTH,
    house_style,
)

# Limits that end the preload from below; all others end it from above.
_FLOORS = ("slip", "slip safety", "least preload")
# Of the width of a panel: limits closer than this share one label.
_MERGE = 0.045
_TEXT = 7.0


@dataclass(frozen=True)
class Recommended:
    """Preload of an element that the study recommends, and what tightening makes of it.

    Parameters
    ----------
    largest, least : float
        [N]
    present : float
        The robot's own [N].
    """

    largest: float
    least: float
    present: float


def curves_figure(
    curves: Sequence[Any], recommended: Mapping[str, Recommended], units: Sequence[JointUnits]
) -> Figure:
    """Joint stiffness over the preload of each element, all other preloads as recommended.

    Parameters
    ----------
    curves : sequence of PreloadCurve
        The first of each element is drawn in full, further load cases thinly.
    recommended : mapping of element key to Recommended
    units : sequence of JointUnits
    """
    by_key: dict[str, list[Any]] = {}
    for curve in curves:
        by_key.setdefault(curve.key, []).append(curve)
    with house_style():
        columns = min(3 if len(by_key) > 4 else 2, len(by_key))
        rows = -(-len(by_key) // columns)
        height = 2.45 if columns == 3 else 2.9
        figure = Figure(figsize=(WIDTH, 0.5 + height * rows))
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid[len(by_key) :]:
            axes.set_visible(False)
        for place, (key, own) in enumerate(by_key.items()):
            axes = grid[place]
            _curve_panel(axes, own, recommended[key])
            axes.set_title(f"{spoken(key).capitalize()} [{units[own[0].joint - 1].stiffness}]")
            if place + columns >= len(by_key):
                axes.set_xlabel("largest preload of one bolt or pin [kN]")
        handles, labels = grid[0].get_legend_handles_labels()
        below = -0.3 / figure.get_figheight()
        figure.legend(handles, labels, loc="upper left", ncols=5, bbox_to_anchor=(0.05, below))
        figure.subplots_adjust(left=0.07, right=0.995, wspace=0.24, hspace=0.36)
        return figure


def _curve_panel(axes: Axes, curves: Sequence[Any], chosen: Recommended) -> None:
    main = curves[0]
    force = main.preload / 1e3
    low, high = np.nan_to_num(main.stiffness_low), np.nan_to_num(main.stiffness_high)
    axes.axvspan(
        chosen.least / 1e3,
        chosen.largest / 1e3,
        color=SKY,
        alpha=0.22,
        linewidth=0,
        zorder=0,
        label="least to largest preload as tightened",
    )
    for other in curves[1:]:
        axes.plot(other.preload / 1e3, other.stiffness, color=GREY, linewidth=0.9, zorder=2)
    axes.fill_between(
        force, low, high, color=BLUE, alpha=0.25, linewidth=0, label="scatter of the stiffness"
    )
    axes.plot(force, main.stiffness, color=BLUE, linewidth=1.9, label="joint stiffness", zorder=3)
    at = float(np.interp(chosen.largest, main.preload, main.stiffness))
    axes.axvline(chosen.present / 1e3, color=INK, linewidth=1.0, linestyle=(0, (1.5, 1.5)))
    axes.plot([], [], color=INK, linewidth=1.0, linestyle=(0, (1.5, 1.5)), label="present preload")
    axes.plot(chosen.largest / 1e3, at, "o", color=BLACK, markersize=5, label="recommended")
    _stiffness_scale(axes, main, at)
    axes.set_xlim(force[0], force[-1])
    _draw_limits(axes, main.limits)
    axes.locator_params(axis="x", nbins=7)
    axes.locator_params(axis="y", nbins=5)


def _stiffness_scale(axes: Axes, curve: Any, at: float) -> None:
    """Leave the collapse near slip out of the axis; what matters lies above it."""
    held = curve.stiffness[np.isfinite(curve.stiffness) & (curve.stiffness > 0.5 * at)]
    top = max(float(np.nanmax(curve.stiffness_high)), at)
    bottom = min(float(held.min()), at) if held.size else 0.0
    room = max(top - bottom, 0.01 * top)
    # The labels of the limits stand in the upper part.
    axes.set_ylim(bottom - 0.08 * room, top + 0.75 * room)


def _draw_limits(axes: Axes, limits: Mapping[str, float]) -> None:
    """Vertical lines at the preloads where limits bind, the forbidden side shaded."""
    left, right = axes.get_xlim()
    seen = {
        name: force / 1e3
        for name, force in limits.items()
        if np.isfinite(force) and left <= force / 1e3 <= right
    }
    floors = [force for name, force in seen.items() if name in _FLOORS]
    ceilings = [force for name, force in seen.items() if name not in _FLOORS]
    if floors:
        axes.axvspan(left, max(floors), color=PALE, alpha=0.5, linewidth=0, zorder=0)
    if ceilings:
        axes.axvspan(min(ceilings), right, color=PALE, alpha=0.5, linewidth=0, zorder=0)
    groups: list[tuple[float, list[str]]] = []
    for name, force in sorted(seen.items(), key=lambda each: each[1]):
        colour = VERMILLION if name in _FLOORS else GREY
        axes.axvline(force, color=colour, linewidth=1.0, linestyle=(0, (4, 2)), zorder=1)
        if groups and force - groups[-1][0] < _MERGE * (right - left):
            groups[-1][1].append(name)
        else:
            groups.append((force, [name]))
    for force, names in groups:
        near_end = force > right - _MERGE * (right - left)
        axes.annotate(
            "\n".join(names),
            (force, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(-2 if near_end else 2, -1),
            textcoords="offset points",
            rotation=90,
            ha="right" if near_end else "left",
            va="top",
            fontsize=_TEXT,
            linespacing=1.15,
            color=VERMILLION if names[0] in _FLOORS else GREY,
        )


def front_figure(front: Any, units: Sequence[JointUnits], joints: Sequence[int]) -> Figure:
    """Pareto front between total preload and stiffness, its knee marked.

    Parameters
    ----------
    front : ParetoFront
    units : sequence of JointUnits
    joints : sequence of int
        One joint: its stiffness is drawn; several: the least relative stiffness.
    """
    total = np.array([point.total_preload for point in front.points]) / 1e3
    if len(joints) == 1:
        value = np.array([point.stiffness[0] for point in front.points])
        label = f"least stiffness of joint {joints[0]} [{units[joints[0] - 1].stiffness}]"
    else:
        value = 100 * np.array([point.level for point in front.points])
        label = "least relative stiffness of any joint [%]"
    with house_style():
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
        figure.subplots_adjust(left=0.12, right=0.99)
        return figure


def _level_if_flat(axes: Axes) -> None:
    """Show a front that hardly rises as level, not as magnified rounding."""
    low, high = axes.get_ylim()
    middle = 0.5 * (low + high)
    if high - low < 1e-3 * abs(middle):
        axes.set_ylim(middle * (1 - 1e-3), middle * (1 + 1e-3))


def shares_figure(shares: Mapping[int, Sequence[Any]], free: Sequence[str]) -> Figure:
    """Share of every element in the wind-up of its joint, the weakest spring first.

    Parameters
    ----------
    shares : mapping of joint number to shares
        Of one load case each.
    free : sequence of str
        Names of the elements that the study tightens; written in bold.
    """
    columns = min(3, len(shares))
    rows = -(-len(shares) // columns)
    most = max(len(each) for each in shares.values())
    with house_style():
        figure = Figure(figsize=(WIDTH if columns > 1 else WIDTH * 0.62, 0.5 + rows * _tall(most)))
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid[len(shares) :]:
            axes.set_visible(False)
        for place, (joint, own) in enumerate(shares.items()):
            axes = grid[place]
            ordered = sorted(own, key=lambda each: -each.share)
            for row, each in enumerate(ordered):
                colour = ELEMENT_COLOURS.get(each.kind, GREY)
                axes.barh(row, 100 * each.share, height=0.7, color=colour)
                text = f" {significant(100 * each.share, 2)} %"
                axes.text(100 * each.share, row, text, va="center", fontsize=8)
            axes.set_yticks(range(len(ordered)), [spoken(each.element) for each in ordered])
            for label, each in zip(axes.get_yticklabels(), ordered, strict=True):
                label.set_fontweight("bold" if each.element in free else "normal")
            axes.set_ylim(most - 0.4, -0.6)
            axes.set_xlim(0.0, 118.0)
            axes.set_xticks([0, 25, 50, 75, 100])
            axes.grid(visible=False, axis="y")
            axes.set_title(f"Joint {joint}, {own[0].case}")
            if place + columns >= len(shares):
                axes.set_xlabel("share of the wind-up [%]")
        figure.subplots_adjust(
            left=0.13 if columns > 1 else 0.25, right=0.99, wspace=0.62, hspace=0.34
        )
        return figure


def _tall(bars: int) -> float:
    return 0.62 + 0.23 * bars


def loosening_figure(first_slip: Mapping[str, float], slip: Mapping[str, float]) -> Figure:
    """How far each connection may loosen before its rim and then all of it slips.

    Parameters
    ----------
    first_slip, slip : mapping of element key to float
        Share of the least preload that is left then.
    """
    keys = list(slip)
    with house_style():
        figure = Figure(figsize=(WIDTH * 0.8, 0.75 + 0.3 * len(keys)))
        axes = figure.subplots()
        for row, key in enumerate(keys):
            whole, rim = (100 * min(max(each[key], 0.0), 1.0) for each in (slip, first_slip))
            rim = max(rim, whole)
            axes.barh(row, whole, color=VERMILLION, height=0.62)
            axes.barh(row, rim - whole, left=whole, color=ORANGE, height=0.62)
            axes.barh(row, 100 - rim, left=rim, color=GREEN, height=0.62, alpha=0.75)
        for colour, name in ((VERMILLION, "slips"), (ORANGE, "rim slips"), (GREEN, "holds")):
            axes.barh(0, 0, color=colour, label=name)
        axes.set_yticks(range(len(keys)), [spoken(key) for key in keys])
        axes.set_ylim(len(keys) - 0.4, -0.6)
        axes.set_xlim(0.0, 100.0)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} %"))
        axes.set_xlabel("preload left, of the least that tightening leaves")
        axes.grid(visible=False, axis="y")
        below = -0.55 / (0.75 + 0.3 * len(keys))
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, below), ncols=3, borderaxespad=0.0)
        figure.subplots_adjust(left=0.24, right=0.97)
        return figure
