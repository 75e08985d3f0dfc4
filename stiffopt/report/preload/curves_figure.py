"""Figure of joint stiffness over the preload of a bolt or pin, with limits and scatter."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiffopt.preload.curves import FLOORS, PreloadCurve
from stiffopt.preload.problem import FreeElement, PreloadProblem
from stiffopt.preload.solution import PreloadSolution
from stiffopt.report.common import svg
from stiffopt.report.common.robot import JointUnits
from stiffopt.report.preload.words import present_preload, readable

# Width of a label line over that of a panel; limits closer than this share one label.
_LABEL_WIDTH_SHARE = 0.055
# Margins above the panels, below them with the legend, and between two rows [inch].
_TOP_INCH, _BOTTOM_INCH, _ROW_GAP_INCH = 0.3, 0.85, 0.5


@dataclass(frozen=True)
class PreloadView:
    """Stiffness over the preload of an element, with the scatter of its design."""

    preload: np.ndarray  # (K,) preload of one bolt or pin, ascending [N]
    stiffness: np.ndarray  # (K,) stiffness of its joint [N m/rad]; 0 where the element slips
    # Preloads of the design after scatter and embedding [N].
    least: float
    largest: float
    # Least and largest preload of the present design [N].
    present: tuple[float, float] | None
    # By limit name: lower limits on the least preload, upper limits on the largest [N].
    bounds: Mapping[str, float]
    binding: frozenset[str]  # active limits


def preload_view(
    problem: PreloadProblem, solution: PreloadSolution, element: FreeElement, curve: PreloadCurve
) -> PreloadView:
    """Return the view of an element, with lower limits converted to the least preload."""

    def least(largest: float) -> float:
        return max(float(element.least(largest)), 0.0)

    # Both ends of the scatter are points of one curve.
    preload = np.concatenate([element.least(curve.preload), curve.preload])
    stiffness = np.concatenate([curve.stiffness, curve.stiffness_high])
    order = np.argsort(preload)
    present = present_preload(element)
    floors = {name: least(curve.limits[name]) for name in FLOORS if name in curve.limits}
    floor = max(floors, key=lambda name: floors[name])
    # At "slip" the curve drops to zero anyway.
    ceilings = {n: f for n, f in curve.limits.items() if n not in (*FLOORS, "slip")}
    active = {
        row.kind
        for row in solution.rows
        if row.active and row.element in ("", element.key) and row.joint in (None, element.joint)
    }
    bounds = {floor: floors[floor], **ceilings}
    return PreloadView(
        preload=preload[order],
        stiffness=stiffness[order],
        least=least(solution.preloads[element.key]),
        largest=solution.preloads[element.key],
        present=None if present is None else (least(present), present),
        bounds=bounds,
        binding=frozenset(active & set(bounds)),
    )


@svg.figure_style()
def curves_figure(
    problem: PreloadProblem,
    solution: PreloadSolution,
    curves: Sequence[PreloadCurve],
    units: Sequence[JointUnits],
) -> Figure:
    """Plot joint stiffness over the preload of each element, other preloads as recommended.

    The load case of the largest torque is drawn with a thick line, others with thin lines.
    """
    count = len(problem.elements)
    columns = min(2 if count in (2, 4) else 3, count)
    rows = -(-count // columns)
    panel = 1.75 if columns == 3 else 2.3 if columns == 2 else 2.6
    height = _TOP_INCH + rows * panel + (rows - 1) * _ROW_GAP_INCH + _BOTTOM_INCH
    figure, grid = svg.panels(count, columns, (svg.WIDTH, height))
    for place, (axes, element) in enumerate(zip(grid, problem.elements, strict=True)):
        own = [curve for curve in curves if curve.key == element.key]
        own.sort(key=lambda curve: -abs(curve.torque))
        _draw_panel(axes, [preload_view(problem, solution, element, curve) for curve in own])
        unit = units[element.joint - 1].stiffness
        axes.set_title(f"{readable(element.key).capitalize()} [{unit}]")
        if place + columns >= count:
            axes.set_xlabel("preload of one bolt or pin [kN]")
    drawn = [axes.get_legend_handles_labels() for axes in grid]
    legend = {name: line for lines, names in drawn for line, name in zip(lines, names, strict=True)}
    lines, names = list(legend.values()), list(legend)
    figure.legend(lines, names, loc="lower left", ncols=4, bbox_to_anchor=(0.05, 0.0))
    figure.subplots_adjust(
        left=0.07,
        right=0.995,
        bottom=_BOTTOM_INCH / height,
        top=1 - _TOP_INCH / height,
        wspace=0.24,
        hspace=_ROW_GAP_INCH / panel,
    )
    return figure


def _draw_panel(axes: Axes, views: Sequence[PreloadView]) -> None:
    main = views[0]
    least, largest = main.least / 1e3, main.largest / 1e3
    axes.axvspan(
        least,
        largest,
        color=svg.SKY,
        alpha=0.3,
        linewidth=0,
        zorder=0,
        label="preload as tightened",
    )
    for view in views[1:]:
        axes.plot(view.preload / 1e3, view.stiffness, color=svg.GREY, linewidth=0.9, zorder=2)
    axes.plot(
        main.preload / 1e3,
        main.stiffness,
        color=svg.BLUE,
        linewidth=1.9,
        label="stiffness of the joint",
        zorder=3,
    )
    ends = np.interp([main.least, main.largest], main.preload, main.stiffness)
    axes.plot(
        [least, largest],
        ends,
        "o",
        color=svg.BLACK,
        markersize=4.5,
        label="least and largest",
        zorder=4,
    )
    bottom, top = _stiffness_range([view.stiffness for view in views], ends)
    # Space above for labels of lower limits, below for the present preload.
    room = top - bottom
    axes.set_ylim(bottom - 0.2 * room, top + 0.5 * room)
    shown = [main.preload[-1], main.largest, *_nearest_bounds(main.bounds)]
    if main.present is not None:
        shown += main.present
        axes.plot(
            [force / 1e3 for force in main.present],
            [bottom - 0.1 * room] * 2,
            color=svg.INK,
            linewidth=1.2,
            marker="|",
            markersize=7,
            linestyle=(0, (1.5, 1.2)),
            label="present preload, least to largest",
        )
    # Space for labels of upper limits beside their lines.
    right = 1.03 * max(shown)
    ceilings = sorted(f for n, f in main.bounds.items() if n not in FLOORS and f <= right)
    for lines, force in enumerate(reversed(ceilings), start=1):
        right = max(right, force / (1.0 - lines * _LABEL_WIDTH_SHARE))
    axes.set_xlim(0.0, 1.001 * right / 1e3)
    drawn = {n: f / 1e3 for n, f in main.bounds.items() if n in FLOORS or f in ceilings}
    _draw_bounds(axes, drawn, main.binding)
    # No common power of ten, which would overlap the title.
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.6g}")
    axes.locator_params(axis="x", nbins=7)
    axes.locator_params(axis="y", nbins=5)


def _nearest_bounds(bounds: Mapping[str, float]) -> list[float]:
    """Return the lower limit and the nearest upper one, which every panel shows [N]."""
    floors = [force for name, force in bounds.items() if name in FLOORS]
    ceilings = [force for name, force in bounds.items() if name not in FLOORS]
    return [*floors, *([min(ceilings)] if ceilings else [])]


def _stiffness_range(curves: Sequence[np.ndarray], ends: np.ndarray) -> tuple[float, float]:
    """Return the displayed range: without the drop at slip, at least 1 % of the stiffness."""
    tops = [float(curve.max()) for curve in curves]
    top = max(*tops, float(ends.max()))
    if top <= 0.0:  # another connection of the joint slips, whatever this one's preload
        return 0.0, 1.0
    # Both ends of the scatter are shown, except one that slips.
    shown = [ends[ends > 0.0]]
    shown += [curve[curve > 0.97 * most] for curve, most in zip(curves, tops, strict=True) if most]
    return min(float(np.concatenate(shown).min()), 0.99 * top), top


def _draw_bounds(axes: Axes, bounds: Mapping[str, float], binding: Collection[str]) -> None:
    """Draw vertical lines at the limits, with the forbidden side shaded and labelled."""
    left, right = axes.get_xlim()
    for name, force in bounds.items():
        if name in FLOORS and force > left:
            axes.axvspan(left, min(force, right), color=svg.PALE, alpha=0.5, linewidth=0, zorder=0)
    ceilings = [force for name, force in bounds.items() if name not in FLOORS]
    if ceilings and min(ceilings) < right:
        axes.axvspan(min(ceilings), right, color=svg.PALE, alpha=0.5, linewidth=0, zorder=0)
    groups: list[tuple[float, list[str]]] = []
    for name, force in sorted(bounds.items(), key=lambda each: each[1]):
        if not left <= force <= right:
            continue
        colour = svg.VERMILLION if name in FLOORS else svg.GREY
        style = {"linewidth": 1.8} if name in binding else {"linewidth": 1.0, "dashes": (4, 2)}
        axes.axvline(force, color=colour, zorder=1, **style)
        # A label is as wide as it has lines.
        line = _LABEL_WIDTH_SHARE * (right - left)
        near = groups and force - groups[-1][0] < len(groups[-1][1]) * line
        if near and name not in FLOORS and groups[-1][1][0] not in FLOORS:
            groups[-1][1].append(name)
        else:
            groups.append((force, [name]))
    for force, names in groups:
        _draw_label(axes, force, names, names[0] in FLOORS, any(name in binding for name in names))


def _draw_label(
    axes: Axes, force: float, names: Sequence[str], beside_left: bool, binds: bool
) -> None:
    """Label a line: lower limits at the top, upper limits at the bottom."""
    left, right = axes.get_xlim()
    floor = names[0] in FLOORS
    room = _LABEL_WIDTH_SHARE * (right - left) * len(names)
    if beside_left and force - left < room:
        beside_left = False
    elif not beside_left and right - force < room:
        beside_left = True
    axes.annotate(
        "\n".join(names),
        (force, 1.0 if floor else 0.0),
        xycoords=("data", "axes fraction"),
        xytext=(-2 if beside_left else 2, -1 if floor else 3),
        textcoords="offset points",
        rotation=90,
        ha="right" if beside_left else "left",
        va="top" if floor else "bottom",
        fontsize=7.0,
        fontweight="bold" if binds else "normal",
        linespacing=1.1,
        color=svg.VERMILLION if floor else svg.GREY,
    )
