"""Figures of a solve in space: path of the tool, and wind-up of the joints by element."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.report.common.robot import common_unit, element_colour, joint_units, windup_by_kind
from stiffopt.report.common.svg import BLACK, GREY, WIDTH, figure_style, subplots
from stiffopt.report.common.text import number, si
from stiffopt.report.solve.figures import ComparedMotion, motion_style
from stiffopt.result.assessment import Assessment


@figure_style()
def path_figure(problem: TrajectoryProblem, motions: Sequence[ComparedMotion], part: str) -> Figure:
    """Plot the tool path in two projections, planned and with magnified deflection.

    `problem`: problem whose via points are marked. `motions`: motions, all with the same
    magnification. `part`: part of the deflection that is added to the planned path.
    """
    first = motions[0].assessment
    spans = np.ptp(first.tool, axis=0)
    widest, middle, least = (int(axis) for axis in np.argsort(-spans, kind="stable"))
    largest = max(motion.peak(part) for motion in motions)
    factor = exaggeration(max(float(spans.max()), 1e-3), largest)
    figure = Figure()
    # Paths flatter than this are drawn one projection above the other.
    stacked = bool(spans[middle] < 0.45 * spans[widest])
    rows, columns = (2, 1) if stacked else (1, 2)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, vertical in zip(grid, (middle, least), strict=True):
        _draw_projection(axes, problem, motions, part, factor, (widest, vertical))
    _fit_panels(figure, list(grid), stacked)
    handles, labels = grid[0].get_legend_handles_labels()
    below = -0.5 / figure.get_figheight()
    figure.legend(handles, labels, loc="upper left", ncols=2, bbox_to_anchor=(0.06, below))
    return figure


def _fit_panels(figure: Figure, grid: list[Axes], stacked: bool) -> None:
    """Place the axes with one scale for all directions."""
    across = max(float(np.ptp(axes.get_xlim())) for axes in grid)
    width = (0.92 if stacked else 0.43) * WIDTH
    scale = width / across
    # Least height of a projection, and gap between two [inch].
    tall = [max(scale * float(np.ptp(axes.get_ylim())), 1.1) for axes in grid]
    total = sum(tall) + 0.55 if stacked else max(tall)
    figure.set_size_inches(WIDTH, total)
    places = [(0.06, 1.0 - tall[0] / total), (0.06, 0.0)]
    if not stacked:
        places = [(0.06, 0.0), (0.57, 0.0)]
    for axes, height, (left, base) in zip(grid, tall, places, strict=True):
        axes.set_position((left, base, width / WIDTH, height / total))
        for limits, extent in ((axes.set_xlim, across), (axes.set_ylim, height / scale)):
            bounds = axes.get_xlim() if limits == axes.set_xlim else axes.get_ylim()
            middle = 0.5 * (bounds[0] + bounds[1])
            limits(middle - 0.5 * extent, middle + 0.5 * extent)


def _draw_projection(
    axes: Axes,
    problem: TrajectoryProblem,
    motions: Sequence[ComparedMotion],
    part: str,
    factor: float,
    plane: tuple[int, int],
) -> None:
    for index, motion in enumerate(motions):
        style = motion_style(index)
        assessment = motion.assessment
        every = np.linspace(0, len(assessment.time) - 1, 300).astype(int)
        planned = 1e3 * assessment.tool[every]
        bent = planned + 1e3 * factor * assessment.deflection[part][every]
        thin_line = {"color": style["color"], "linewidth": 0.8, "alpha": 0.55}
        axes.plot(*planned[:, plane].T, label=f"{motion.label}: planned", **thin_line)
        axes.plot(*bent[:, plane].T, label=f"with {part} deflection × {factor:g}", **style)
    marks = [motions[0].assessment.tool[0], motions[0].assessment.tool[-1]]
    for point, mark in zip(marks, ("o", "s"), strict=True):
        axes.plot(*(1e3 * point[list(plane)]), mark, color=BLACK, markersize=5, zorder=5)
    vias = [via.position for via in problem.vias if via.position is not None]
    for via in vias:
        axes.plot(*(1e3 * np.asarray(via)[list(plane)]), "D", color=GREY, markersize=5, zorder=4)
    names = "xyz"
    axes.set_xlabel(f"{names[plane[0]]} [mm]")
    axes.set_ylabel(f"{names[plane[1]]} [mm]")


def exaggeration(extent: float, largest: float) -> float:
    """Return a round factor (1, 2 or 5 times a power of ten) that makes a deflection visible."""
    if largest <= 0:
        return 1.0
    # Share of the path's extent to which the largest deflection is magnified.
    wanted = max(0.08 * extent / largest, 1.0)
    power = 10.0 ** math.floor(math.log10(wanted))
    return power * max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-12))


@figure_style()
def windup_figure(problem: TrajectoryProblem, motion: Assessment, part: str) -> Figure:
    """Plot the wind-up of every joint at the instant of the largest deflection, split by element.

    Without drivetrain chains there is no split; a joint that slips has no bar.
    """
    magnitude = np.linalg.norm(motion.deflection[part], axis=1)
    at = int(np.argmax(magnitude))
    units = joint_units(problem.robot)
    figure, axes = subplots(0.9 + max(0.36 * len(units), 1.4))
    shown: set[str] = set()
    windups = 1e3 * np.abs(motion.windup[at])
    slips = ~np.isfinite(windups)
    windups[slips] = 0.0
    for j, unit in enumerate(units):
        torque = float(motion.spring_torque[at, j])
        left = 0.0
        shares = {} if slips[j] else windup_by_kind(problem.robot.chains[j], torque)
        for kind, share in shares.items():
            label = None if kind in shown else kind.replace("_", " ")
            shown.add(kind)
            width = share * windups[j]
            colour = element_colour(kind)
            axes.barh(j, width, left=left, height=0.62, color=colour, label=label)
            left += width
        size = "slips" if slips[j] else number(windups[j] / 1e3, unit.windup, 3)
        text = f"{size} at {si(torque, unit.torque, 3)}"
        place: dict[str, Any] = {"xytext": (4, 0), "textcoords": "offset points"}
        axes.annotate(text, (windups[j], j), va="center", fontsize=8.5, **place)
    axes.set_yticks(range(len(units)), [unit.label for unit in units])
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.22 * max(float(windups.max()), 1e-9))
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(f"wind-up [{common_unit([u.windup for u in units])}]")
    axes.set_title(f"At {motion.time[at]:.3f} s, where the {part} deflection is largest")
    figure.subplots_adjust(left=0.05, right=0.995)
    if shown:
        axes.legend(loc="lower right", borderaxespad=0.4)
    return figure
