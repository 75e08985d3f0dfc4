"""Elastic simulation: table, figure, notes and page (simulation.html); elastic modes of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import PoseModes
from stiffopt.files import atomic_write
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.report.common import svg
from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.terminal import print_lines, print_table
from stiffopt.report.common.text import percent, scale, si, significant
from stiffopt.report.scene.poses import Poses
from stiffopt.report.scene.still import embedded_scene
from stiffopt.report.solve.compensation import (
    COMPENSATED,
    COMPENSATION_FILTERS,
    compensation_figure,
)
from stiffopt.report.solve.wording import assumed_damping_note, simulation_section
from stiffopt.result.compensation import Compensation
from stiffopt.result.simulation import SimulatedMotion, Simulation

_MOTION_STYLES: tuple[dict[str, Any], ...] = (
    {"color": svg.BLUE, "linewidth": 2.2},
    {"color": svg.VERMILLION, "linestyle": (0, (5, 1.5))},
    {"color": svg.GREEN, "linestyle": (0, (1.5, 1.2))},
    {"color": svg.BLACK, "linestyle": (0, (1.0, 2.5))},
)
PAGE_FILE = "simulation.html"
_TIME_AFTER_ARRIVAL = 0.4  # shown in the figure and the scene [s]
_VIBRATION_PART = "vibratory"  # part of the deflection that the scene magnifies


@svg.figure_style()
def deviation_figure(simulation: Simulation) -> Figure:
    """Plot the magnitude of the tool's deviation over time, all motions."""
    figure, axes = svg.subplots(3.7)
    largest = max(motion.simulated.peak for motion in simulation.motions)
    factor, unit = scale(largest, "m")
    for motion, style in zip(simulation.motions, _MOTION_STYLES, strict=False):
        found = motion.simulated
        shown = found.time <= found.duration + _TIME_AFTER_ARRIVAL
        values = factor * found.distance[shown]
        axes.plot(found.time[shown], values, label=motion.name, **style)
        at = int(np.searchsorted(found.time, found.duration))
        axes.plot(found.duration, factor * found.distance[at], "o", color=style["color"])
    axes.axhline(factor * simulation.optimised.simulated.band, color=svg.GREY, linewidth=0.8)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"deviation of the tool [{unit}]")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    axes.legend(loc="upper right")
    figure.subplots_adjust(left=0.06, right=0.995)
    return figure


def print_modes(rows: Sequence[PoseModes]) -> None:
    """Print a table of modes per pose, lowest first, and the note on assumed damping."""
    head = ("mode", "frequency", "damping", "shape")
    for row in rows:
        cells = [
            (
                str(k),
                f"{significant(mode.frequency, 4)} Hz",
                percent(mode.damping, 2),
                mode.describe(),
            )
            for k, mode in enumerate(row.modes, start=1)
        ]
        print_table(head, cells, title=row.name, numbers=head[:3])
    print_lines(assumed_damping_note(rows[0].assumed_damping))


@svg.figure_style()
def write_modes_figure(rows: Sequence[PoseModes], path: Path) -> Path:
    """Write the frequencies over a motion as SVG; return the path."""
    figure, axes = svg.subplots(3.7)
    times = [row.time for row in rows]
    for k in range(len(rows[0].modes)):
        frequencies = [row.modes[k].frequency for row in rows]
        axes.plot(times, frequencies, label=f"mode {k + 1}", **svg.line_style(k))
    svg.set_log_scale(axes, "y")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("frequency [Hz]")
    axes.margins(x=0.01)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    drawing = svg.to_svg(
        figure, "modes", "Natural frequencies of the elastic modes along the motion"
    )
    atomic_write(path, drawing)
    return path


def write_simulation_report(
    problem: TrajectoryProblem,
    arm: ElasticArm,
    simulation: Simulation,
    directory: str | Path,
    compensation: Compensation | None = None,
) -> Path:
    """Write simulation.html and its figures; return its path.

    `arm`: the simulated arm. `compensation`: deviations of the written command on uncertain arms.
    """
    own = simulation.optimised.simulated
    shown = [motion for motion in simulation.motions if motion.name != "optimised"][:1]
    motions = {"optimised": elastic_poses(arm, own)}
    motions |= {each.name: elastic_poses(arm, each.simulated) for each in shown}
    figures = PageFigures("simulation", png=False)
    figures.draw("deviation", deviation_figure(simulation), "Deviation of the tool over time")
    if compensation is not None:
        drawn = compensation_figure(compensation)
        figures.draw("compensation", drawn, COMPENSATED)
    scene = embedded_scene(problem.robot, motions, _VIBRATION_PART, problem.cell)
    figures.draw("arm", scene.still, "The arm with the paths of its tool")
    after = "" if own.peak_after is None else f", {si(own.peak_after, 'm', 3)} after arrival"
    context = {
        "title": f"{problem.title or problem.robot.name}: elastic simulation",
        "headline": f"Peak vibration of the tool {si(own.peak, 'm', 3)} in flight{after}",
        "simulated": simulation_section(simulation),
        "compensation": compensation,
        "space": scene.embedded,
        "still": scene.caption,
    }
    path = Path(directory) / PAGE_FILE
    return write_page("solve/simulation.html.j2", path, context, figures, COMPENSATION_FILTERS)


def elastic_poses(arm: ElasticArm, motion: SimulatedMotion) -> Poses:
    """Return static equilibria at the simulated motor positions, with the links' vibration."""
    end = min(float(motion.time[-1]), motion.duration + _TIME_AFTER_ARRIVAL)
    at = np.unique(np.searchsorted(motion.time, np.linspace(0.0, end, 241)))
    at = np.unique([*at[at < len(motion.time)], int(np.argmax(motion.distance))])
    hanging = arm.static_equilibrium((motion.position + motion.windup)[at])
    bend = hanging - motion.position[at]
    return Poses.bent(
        arm.robot,
        motion.time[at],
        hanging,
        {_VIBRATION_PART: bend},
        {_VIBRATION_PART: motion.distance[at]},
    )
