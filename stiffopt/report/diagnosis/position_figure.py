"""Figure of a run simulated from its commands: positions and errors over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from stiffopt.report.common.svg import (
    BLUE,
    GREY,
    INK,
    VERMILLION,
    WIDTH,
    decimate_curve,
    figure_style,
)

if TYPE_CHECKING:
    from stiffopt.discovery.position_fit import PositionRun


def position_figure(run: PositionRun, joints: Sequence[str], prismatic: np.ndarray) -> Figure:
    """Plot command, measured and simulated position of each joint over time, and the errors."""
    n = len(joints)
    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.7 + 1.45 * n))
        grid = figure.subplots(n, 2, squeeze=False, sharex=True)
        for j, (left, right) in enumerate(grid):
            for values, colour, label, width in (
                (run.command, GREY, "command", 0.9),
                (run.measured, INK, "measured", 1.8),
                (run.before, VERMILLION, "before", 1.1),
                (run.after, BLUE, "after", 1.1),
            ):
                shown = decimate_curve(run.time, np.nan_to_num(values[:, j]))
                left.plot(*shown, color=colour, label=label, linewidth=width)
            for values, colour in ((run.before, VERMILLION), (run.after, BLUE)):
                error = 1e3 * np.nan_to_num(values[:, j] - run.measured[:, j])
                right.plot(*decimate_curve(run.time, error), color=colour, linewidth=1.1)
            left.set_title(f"J{j + 1} {joints[j]}")
            left.set_ylabel("m" if prismatic[j] else "rad")
            right.set_title("simulated less measured")
            right.set_ylabel("mm" if prismatic[j] else "mrad")
        for axes in grid[-1]:
            axes.set_xlabel("time [s]")
        handles, labels = grid[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper right", ncols=4, bbox_to_anchor=(0.99, 1.0))
        height = figure.get_figheight()
        figure.subplots_adjust(
            left=0.07, right=0.99, top=1.0 - 0.5 / height, bottom=0.45 / height, hspace=0.5
        )
        return figure
