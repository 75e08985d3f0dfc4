"""Figures of results for notebooks: `Solution.plot()` and `Diagnosis.plot()`."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.errors import InputError
from stiffopt.report.common.svg import WIDTH, figure_style, panels
from stiffopt.report.diagnosis.figures import residual_figure
from stiffopt.result.solution import Solution


def figure_of(result: Any) -> Figure:
    """Plot joint motion and deflection of a solution, or residuals over noise of a diagnosis."""
    if isinstance(result, Diagnosis):
        return residual_figure(result)
    assert isinstance(result, Solution)
    return _motion_figure(result)


@figure_style()
def _motion_figure(solution: Solution) -> Figure:
    motion = solution.assessment
    if motion is None:
        raise InputError("there is no motion to plot: " + solution.message)
    figure, axes = panels(4, 2, (WIDTH, 5.6), sharex=True)
    for place, values, name in (
        (axes[0], motion.position, "position [rad, m]"),
        (axes[1], motion.velocity, "velocity [rad/s, m/s]"),
        (axes[2], motion.torque, "drive torque [N m, N]"),
    ):
        for j, column in enumerate(values.T, start=1):
            place.plot(motion.time, column, label=f"J{j}")
        place.set_ylabel(name)
    axes[0].legend(ncols=3)
    for part, values in motion.deflection.items():
        if abs(values).max() > 0.0:
            size = 1e3 * (values**2).sum(axis=1) ** 0.5
            axes[3].plot(motion.time, size, label=part)
    axes[3].set_ylabel("tool deflection [mm]")
    if axes[3].lines:
        axes[3].legend()
    for place in axes[2:]:
        place.set_xlabel("time [s]")
    figure.tight_layout()
    return figure
