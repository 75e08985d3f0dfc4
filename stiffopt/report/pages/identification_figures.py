"""Figures of stiffness identified from static deflections."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from stiffopt.identification.result import StaticStiffness
from stiffopt.report.common.svg import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    SKY,
    VERMILLION,
    WIDTH,
    figure_style,
)
from stiffopt.report.common.text import decades, scale

_MARKER_STYLES = (
    ("stiffness", "identified, 95 % confidence interval", "o", BLUE, 6),
    ("least_squares", "ordinary least squares", "d", ORANGE, 4),
    ("nominal", "nominal", "|", VERMILLION, 14),
)


def stiffness_figure(result: StaticStiffness) -> Figure:
    """Plot the stiffness of every joint with its confidence interval, and nominal values."""
    shown = [joint for joint in result.joints if joint.lower is not None]
    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.9 + 0.42 * max(len(result.joints), 2)))
        axes = figure.subplots()
        values = [
            each
            for j in shown
            for each in (j.lower, j.upper, j.stiffness, j.least_squares, j.nominal)
            if each is not None
        ] or [1.0]
        low, high = 0.7 * min(values), 1.4 * max(values)
        for joint in shown:
            row, start, end = joint.joint, joint.lower or low, joint.upper or high
            axes.plot([start, end], [row, row], color=BLUE, linewidth=2.2, solid_capstyle="butt")
            if joint.upper is None:
                axes.plot(high, row, marker=">", color=BLUE, markersize=6, clip_on=False)
        for name, label, marker, colour, size in _MARKER_STYLES:
            known = [(getattr(j, name), j.joint) for j in result.joints if getattr(j, name)]
            if known:
                x, y = zip(*known, strict=True)
                axes.plot(x, y, marker, color=colour, ms=size, mew=1.8, label=label, zorder=3)
        for joint in result.joints:
            if joint.lower is None:
                text = "not loaded by these poses" if joint.status == "not_loaded" else "confounded"
                axes.text(low * 1.03, joint.joint, text, va="center", fontsize=8, color=GREY)
        axes.set_xscale("log")
        axes.set_xlim(low, high)
        axes.xaxis.set_major_formatter(lambda x, _: decades(x, 1))
        axes.xaxis.set_minor_formatter("")
        axes.set_yticks([j.joint for j in result.joints], [f"J{j.joint}" for j in result.joints])
        axes.set_ylim(len(result.joints) + 0.6, 0.4)
        units = " or ".join(sorted({j.unit for j in result.joints}))
        axes.set_xlabel(f"stiffness [{units}]")
        axes.grid(visible=False, axis="y")
        if axes.get_legend_handles_labels()[0]:  # not where nothing could be identified
            below = -0.3 / figure.get_figheight()
            figure.legend(loc="upper left", ncols=3, bbox_to_anchor=(0.03, below))
        figure.subplots_adjust(left=0.04, right=0.97)
        return figure


def prediction_figure(result: StaticStiffness) -> Figure:
    """Plot measured displacements against leave-one-out predictions, every pose."""
    measured = result.rows.displacement
    factor, unit = scale(float(np.max(np.abs(measured))), "m")
    outlying = np.zeros(len(measured), dtype=bool)
    outlying[[pose - 1 for pose in result.outliers]] = True
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.5))
        grid = figure.subplots(1, 3)
        for i, (axes, name) in enumerate(zip(grid, "xyz", strict=True)):
            x, y = factor * result.left_out[:, i], factor * measured[:, i]
            ends = [min(x.min(), y.min()), max(x.max(), y.max())]
            axes.plot(ends, ends, color=GREY, linewidth=0.9)
            axes.plot(
                x[~outlying], y[~outlying], "o", color=BLUE, markersize=4, label="pose left out"
            )
            if outlying.any():
                axes.plot(
                    x[outlying], y[outlying], "s", color=VERMILLION, markersize=5, label="outlier"
                )
            axes.set_title(f"{name} [{unit}]")
            axes.set_xlabel("predicted")
        grid[0].set_ylabel("measured")
        handles, labels = grid[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper left", ncols=2, bbox_to_anchor=(0.03, -0.05))
        figure.subplots_adjust(left=0.06, right=0.99, wspace=0.2)
        return figure


def poses_figure(result: StaticStiffness) -> Figure:
    """Plot the leave-one-out error of every pose, and that of the nominal stiffness."""
    measured = result.rows.displacement
    error = np.linalg.norm(measured - result.left_out, axis=1)
    factor, unit = scale(float(np.max(error)), "m")
    pose = np.arange(1, len(measured) + 1)
    with figure_style():
        figure = Figure(figsize=(WIDTH, 2.9))
        axes = figure.subplots()
        colours = [VERMILLION if k in result.outliers else BLUE for k in pose.tolist()]
        axes.bar(pose, factor * error, width=0.7, color=colours, label="identified, pose left out")
        nominal = result.source.stiffness
        if nominal is not None:
            predicted = result.rows.compliance_columns() @ (1.0 / nominal)
            before = np.linalg.norm(measured - predicted, axis=1)
            axes.plot(
                pose, factor * before, "_", color=ORANGE, markersize=9, mew=2.0, label="nominal"
            )
        noise = factor * np.sqrt(3.0) * result.scale
        axes.axhline(noise, color=GREY, linewidth=0.9, linestyle=(0, (4, 2)), label="typical error")
        axes.set_xlabel("pose")
        axes.set_ylabel(f"error [{unit}]")
        axes.margins(x=0.01)
        axes.grid(visible=False, axis="x")
        figure.legend(loc="upper left", ncols=3, bbox_to_anchor=(0.03, -0.1))
        figure.subplots_adjust(left=0.06, right=0.99)
        return figure


def models_figure(result: StaticStiffness) -> Figure:
    """Plot the error on fitted and on left-out poses, per model of the wind-up."""
    models = result.torque_dependence.models
    factor, unit = scale(max(model.left_out for model in models), "m")
    with figure_style():
        figure = Figure(figsize=(WIDTH, 0.8 + 0.36 * len(models)))
        axes = figure.subplots()
        for row, model in enumerate(models):
            colour = GREEN if model.candidate else SKY
            axes.plot(
                [factor * model.fit, factor * model.left_out], [row, row], color=colour, zorder=1
            )
            axes.plot(factor * model.fit, row, "o", mfc="white", mec=colour, markersize=6)
            axes.plot(factor * model.left_out, row, "o", color=colour, markersize=7)
        axes.axvline(
            factor * models[0].left_out, color=GREY, linewidth=0.9, linestyle=(0, (4, 2)), zorder=0
        )
        axes.set_yticks(range(len(models)), [model.name for model in models])
        axes.set_ylim(len(models) - 0.5, -0.5)
        axes.set_xlabel(
            f"root mean square error [{unit}]: open symbols fitted poses,"
            " full symbols left-out poses"
        )
        axes.grid(visible=False, axis="y")
        figure.subplots_adjust(left=0.2, right=0.98)
        return figure


def secant_figure(result: StaticStiffness) -> Figure:
    """Plot the secant stiffness of every joint at small, middle and large torque."""
    secant = result.torque_dependence.secant
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.0))
        axes = figure.subplots()
        colours = (BLUE, VERMILLION, GREEN, ORANGE, SKY, GREY)
        for joint, values in secant.items():
            colour = colours[(joint - 1) % len(colours)]
            torque = result.joints[joint - 1].torque
            axes.plot(torque, values, color=colour, marker="o", ms=4, label=f"J{joint}")
        axes.set_xscale("log")
        axes.set_yscale("log")
        for each in (axes.xaxis, axes.yaxis):
            each.set_major_formatter(lambda x, _: decades(x, 1))
            each.set_minor_formatter("")
        axes.set_xlabel("torque [N m], at the 5, 50 and 95 % quantiles of the poses")
        axes.set_ylabel("secant stiffness [N m/rad]")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.subplots_adjust(left=0.07, right=0.92)
        return figure
