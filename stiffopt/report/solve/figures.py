"""Figures of a solve over time: deflection, joint motion, torque, stiffness.

Time in s, angles in deg, deflection in mm or µm, stiffness in
N m/rad (prismatic joints: mm and N/m); bounds are drawn where they are near the curves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.report.common import svg
from stiffopt.report.common.robot import JointUnits, common_unit, joint_units
from stiffopt.report.common.text import scale, si, significant
from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import Solution

PARTS = ("dynamic", "static", "process", "total")
_SMALL_POINTS = 240
_MOTION_STYLES: tuple[dict[str, Any], ...] = (
    {"color": svg.BLUE, "linestyle": "-", "linewidth": 2.2},
    {"color": svg.VERMILLION, "linestyle": (0, (5, 1.5))},
    {"color": svg.GREEN, "linestyle": (0, (1.5, 1.2))},
    {"color": svg.BLACK, "linestyle": (0, (6, 1.5, 1.2, 1.5))},
)
_PART_STYLES: dict[str, dict[str, Any]] = {
    "total": {"color": svg.BLACK, "linestyle": "-"},
    "static": {"color": svg.GREY, "linestyle": (0, (1.5, 1.2))},
    "dynamic": {"color": svg.BLUE, "linestyle": "-", "linewidth": 2.2},
    "process": {"color": svg.VERMILLION, "linestyle": (0, (5, 1.5))},
}


@dataclass(frozen=True)
class ComparedMotion:
    """A motion with its name on the page."""

    name: str
    assessment: Assessment
    feasible: bool

    @property
    def label(self) -> str:
        """Name, with a remark where a limit is exceeded."""
        return self.name if self.feasible else f"{self.name} (exceeds limits)"

    def magnitude(self, part: str) -> np.ndarray:
        """Magnitude of a part of the deflection, (K,) [m]."""
        return np.asarray(np.linalg.norm(self.assessment.deflection[part], axis=1))

    def peak(self, part: str) -> float:
        """Largest finite magnitude [m]; it is infinite where a connection slips."""
        magnitude = self.magnitude(part)
        return float(np.max(magnitude, where=np.isfinite(magnitude), initial=0.0))


def compared_motions(solution: Solution) -> list[ComparedMotion]:
    """List the optimised motion first, then the baselines that exist."""
    motions = []
    if solution.assessment is not None:
        motions.append(ComparedMotion("optimised", solution.assessment, solution.status.usable))
    for name, baseline in solution.baselines.items():
        if baseline.assessment is not None:
            motions.append(ComparedMotion(name, baseline.assessment, baseline.feasible))
    return motions


def focus_part(problem: TrajectoryProblem) -> str:
    """Return the part of the deflection that the problem minimises, else "dynamic"."""
    for objective in problem.objectives:
        if objective.kind.deflection_part:
            return objective.kind.deflection_part
    return "dynamic"


def motion_style(index: int) -> dict[str, Any]:
    """Return the line style of a compared motion; the optimised one has index 0."""
    return dict(_MOTION_STYLES[index % len(_MOTION_STYLES)])


@svg.figure_style()
def deflection_figure(motions: Sequence[ComparedMotion], part: str = "dynamic") -> Figure:
    """Plot the tool deflection over time: one part of all motions, and all parts of the first.

    `motions`: the optimised one first. `part`: key of `Assessment.deflection` that is compared.
    """
    figure, (left, right) = svg.subplots(3.7, 1, 2, width_ratios=(3, 2))
    factor, unit = scale(max(m.peak(part) for m in motions), "m")
    for index, motion in enumerate(motions):
        _peak_curve(left, motion, part, factor, unit, motion.label, motion_style(index))
    left.set_title(f"{part.capitalize()} deflection of the tool, magnitude")
    first = motions[0]
    parts = [p for p in reversed(PARTS) if np.any(first.magnitude(p) > 0)]
    factor_all, unit_all = scale(max(map(first.peak, parts), default=0.0), "m")
    for name in parts:
        _peak_curve(right, first, name, factor_all, unit_all, name, dict(_PART_STYLES[name]))
    right.set_title(f"Parts of the deflection, {first.name} motion")
    for axes, name in ((left, unit), (right, unit_all)):
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"deflection [{name}]")
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.01)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.17), borderaxespad=0.0)
    figure.subplots_adjust(left=0.06, right=0.995, wspace=0.2)
    return figure


def _peak_curve(
    axes: Axes,
    motion: ComparedMotion,
    part: str,
    factor: float,
    unit: str,
    label: str,
    style: dict[str, Any],
) -> None:
    time, values = motion.assessment.time, motion.magnitude(part) * factor
    at = int(np.argmax(values))
    if np.isfinite(values[at]):
        text = f"{label}: peak {significant(values[at], 3)} {unit} at {time[at]:.3f} s"
    else:
        text = f"{label}: slips from {time[at]:.3f} s on"
    axes.plot(*svg.decimate_curve(time, values), label=text, **style)
    axes.plot(time[at], values[at], "o", color=style["color"], markersize=4.5)


@svg.figure_style()
def motion_figure(
    problem: TrajectoryProblem, motion: Assessment, other: ComparedMotion | None
) -> Figure:
    """Plot position, velocity, acceleration and jerk of every joint with the bounds.

    `problem`: problem whose limits are drawn. `other`: baseline drawn with thin lines, without its
    jerk.
    """
    limits, units = problem.active_limits, joint_units(problem.robot)
    upper = (limits.position_upper, limits.velocity, limits.acceleration, limits.jerk)
    lower = (limits.position_lower, -limits.velocity, -limits.acceleration, -limits.jerk)
    count = len(units)
    figure, grid = svg.subplots(0.55 + 1.08 * count, count, 4, sharex=True, squeeze=False)
    for j, unit in enumerate(units):
        for column, quantity in enumerate(("position", "velocity", "acceleration", "jerk")):
            axes = grid[j, column]
            factor = scale(1.0, unit.position)[0] if column < 2 else 1.0
            if other is not None and quantity != "jerk":
                theirs = getattr(other.assessment, quantity)[:, j] * factor
                curve = svg.decimate_curve(other.assessment.time, theirs, _SMALL_POINTS)
                axes.plot(*curve, color=svg.VERMILLION, linewidth=0.9, linestyle=(0, (4, 1.5)))
            values = getattr(motion, quantity)[:, j] * factor
            axes.plot(
                *svg.decimate_curve(motion.time, values, _SMALL_POINTS),
                color=svg.BLUE,
                linewidth=1.5,
            )
            _level_if_flat(axes)
            svg.shade_limits(axes, lower[column][j] * factor, upper[column][j] * factor)
            axes.margins(x=0.0)
            axes.locator_params(axis="y", nbins=4)
            if j == count - 1:
                axes.set_xlabel("time [s]")
        grid[j, 0].set_ylabel(unit.label, rotation=0, ha="right", va="center", weight="bold")
    for column, title in enumerate(_motion_titles(units)):
        grid[0, column].set_title(title)
    figure.subplots_adjust(left=0.08, right=0.995, wspace=0.26, hspace=0.2)
    return figure


def _motion_titles(units: Sequence[JointUnits]) -> list[str]:
    position = common_unit([u.position for u in units])
    speed = common_unit([f"{u.position}/s" for u in units])
    acceleration = common_unit([f"{u.rate}/s²" for u in units])
    jerk = common_unit([f"{u.rate}/s³" for u in units])
    return [
        f"position [{position}]",
        f"velocity [{speed}]",
        f"acceleration [{acceleration}]",
        f"jerk [{jerk}]",
    ]


def _level_if_flat(axes: Axes) -> None:
    """Widen the range of a stationary joint, whose rounding errors would otherwise be magnified."""
    low, high = axes.get_ylim()
    least = 0.02 * max(abs(low), abs(high), 0.05)
    if high - low < least:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - least, middle + least)


@svg.figure_style()
def torque_figure(problem: TrajectoryProblem, motion: Assessment) -> Figure:
    """Plot the drive torque of every joint with its bounds, and its spring torque."""
    limit, units = problem.active_limits.torque, joint_units(problem.robot)
    columns = min(3, len(units))
    height = 0.7 + 1.55 * -(-len(units) // columns)
    figure, grid = svg.panels(len(units), columns, (svg.WIDTH, height), sharex=True)
    for j, axes in enumerate(grid):
        spring = svg.decimate_curve(motion.time, motion.spring_torque[:, j], _SMALL_POINTS)
        drive = svg.decimate_curve(motion.time, motion.torque[:, j], _SMALL_POINTS)
        axes.plot(*spring, color=svg.VERMILLION, linewidth=1.1, linestyle=(0, (5, 1.5)))
        axes.plot(*drive, color=svg.BLUE, linewidth=1.6)
        _level_if_flat(axes)
        svg.shade_limits(axes, -limit[j], limit[j])
        axes.set_title(f"{units[j].label} [{units[j].torque}]")
        axes.margins(x=0.0)
        axes.locator_params(axis="y", nbins=5)
        if j + columns >= len(units):
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)
    figure.subplots_adjust(left=0.06, right=0.995, wspace=0.16, hspace=0.34)
    return figure


@svg.figure_style()
def stiffness_figure(problem: TrajectoryProblem, motion: Assessment) -> Figure:
    """Plot the tangent stiffness of every joint over time with lowest values and lower limits."""
    units = joint_units(problem.robot)
    floors = problem.active_limits.joint_stiffness
    figure, axes = svg.subplots(3.9)
    for j, unit in enumerate(units):
        values = motion.stiffness[:, j]
        if not np.all(np.isfinite(values)):
            continue
        style = svg.line_style(j)
        low = motion.lowest_stiffness[j]
        text = f"{unit.label}: lowest {si(low.value, unit.stiffness)} at {low.time:.3f} s"
        axes.plot(*svg.decimate_curve(motion.time, values), label=text, **style)
        axes.plot(low.time, low.value, "o", color=style["color"], markersize=5)
        if j + 1 in floors:
            axes.axhline(floors[j + 1], color=style["color"], linewidth=0.8, linestyle="--")
    svg.set_log_scale(axes, "y")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"tangent stiffness [{common_unit([u.stiffness for u in units])}]")
    axes.margins(x=0.01)
    figure.subplots_adjust(left=0.07, right=0.995)
    if axes.get_legend_handles_labels()[0]:
        place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (0.0, -0.16)}
        axes.legend(ncols=2 if len(units) < 4 else 3, **place)
    return figure
