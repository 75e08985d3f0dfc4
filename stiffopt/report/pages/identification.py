"""report.html, figures and terminal output of an identified joint stiffness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stiffopt.identification.comparison import (
    JointComparison,
    describe_difference,
    describe_spread,
)
from stiffopt.identification.result import JointStiffness, StaticStiffness
from stiffopt.report.common import svg
from stiffopt.report.common.page import Filters, PageFigures, write_page
from stiffopt.report.common.terminal import print_lines, print_table
from stiffopt.report.common.text import DASH, decades, scale, si

PAGE_FILE = "report.html"
_STATUS_WORDS = {
    "identified": "identified",
    "lower_bound": "lower bound only",
    "not_loaded": "not identifiable",
    "confounded": "not identifiable",
}
_NUMBER_COLUMNS = ("stiffness", "standard deviation", "95 % confidence interval", "nominal")
_DEVIATION_COLUMN = "softer than nominal by (standard deviations)"


@dataclass(frozen=True)
class OutlyingPose:
    """An outlier (pose number from 1): displacement and error [m], weight in the fit."""

    number: int
    displacement: float
    error: float
    weight: float


def write_static_report(result: StaticStiffness, folder: Path) -> Path:
    """Write report.html and its figures as SVG and PNG into `folder`; return the page."""
    figures = PageFigures("static")
    figures.draw("joints", stiffness_figure(result), "Stiffness of the joints")
    figures.draw("prediction", prediction_figure(result), "Displacement measured and predicted")
    figures.draw("poses", poses_figure(result), "Error by pose")
    if result.torque_dependence.models:
        figures.draw("models", models_figure(result), "Torque dependence of the compliance")
    if result.torque_dependence.secant:
        figures.draw("secant", secant_figure(result), "Stiffness over torque")
    context = {
        "result": result,
        "title": f"{result.source.title}: joint stiffness from static deflections",
        "headline": headline(result),
        "subline": error_sentence(result),
        "tilt": tilt_sentence(result),
        "outliers": _outlying_poses(result),
    }
    filters: Filters = {"status_words": status_words, "confidence_interval": confidence_interval}
    path = folder / PAGE_FILE
    return write_page("pages/identification.html.j2", path, context, figures, filters)


def headline(result: StaticStiffness) -> str:
    """Return the number of identified joints in words."""
    count = sum(joint.status == "identified" for joint in result.joints)
    return f"Stiffness of {count} of {len(result.joints)} joints identified"


def error_sentence(result: StaticStiffness) -> str:
    """Return the leave-one-out error in words, with that of the nominal stiffness if known."""
    errors = result.errors
    text = (
        f"Leave-one-out error {si(errors.left_out, 'm', 3)} of a displacement of "
        f"{si(errors.displacement, 'm', 3)} (rms per component)"
    )
    if errors.nominal is not None:
        text += f"; error of the nominal stiffness {si(errors.nominal, 'm', 3)}"
    return f"{text}."


def tilt_sentence(result: StaticStiffness) -> str:
    """Return the identified tilt of bearings in words."""
    if not result.tilt:
        return "not supported by these poses."
    named = ", ".join(
        f"J{each.joint} {decades(1.0 / each.compliance)} N m/rad "
        f"({100.0 * each.sd / each.compliance:.0f} %"
        + (f"; or that of J{', J'.join(map(str, each.rivals))})" if each.rivals else ")")
        for each in result.tilt
    )
    return (
        f"supported, moment stiffness {named}; leave-one-out error with it "
        f"{si(result.errors.left_out, 'm', 3)} in place of "
        f"{si(result.errors.rigid_bearings, 'm', 3)}. It is in the joint stiffness above."
    )


def status_words(joint: JointStiffness) -> str:
    """Return the status of a joint in words."""
    return _STATUS_WORDS[joint.status]


def confidence_interval(lower: float | None, upper: float | None) -> str:
    """Format a confidence interval, which may be open above."""
    if lower is None:
        return DASH
    return f"above {decades(lower)}" if upper is None else f"{decades(lower)} to {decades(upper)}"


def _outlying_poses(result: StaticStiffness) -> list[OutlyingPose]:
    measured = result.rows.displacement
    return [
        OutlyingPose(
            number=pose,
            displacement=float(np.linalg.norm(measured[pose - 1])),
            error=float(np.linalg.norm(measured[pose - 1] - result.predicted[pose - 1])),
            weight=float(result.weight[pose - 1]),
        )
        for pose in result.outliers
    ]


def print_static(result: StaticStiffness, folder: Path) -> None:
    """Print stiffness of the joints, errors, outliers, torque dependence, path of the report."""
    print_lines([f"{headline(result)}. {error_sentence(result)}"])
    rows = [
        (
            f"J{joint.joint}",
            status_words(joint),
            decades(joint.stiffness),
            decades(joint.sd, 2),
            confidence_interval(joint.lower, joint.upper),
            decades(joint.nominal),
            joint.unit,
            DASH if joint.z_nominal is None else f"{joint.z_nominal:+.1f}",
        )
        for joint in result.joints
    ]
    print_table(
        ("", "", *_NUMBER_COLUMNS, "unit", _DEVIATION_COLUMN),
        rows,
        numbers=(*_NUMBER_COLUMNS, _DEVIATION_COLUMN),
    )
    outliers = ", ".join(map(str, result.outliers))
    print_lines(
        (
            *(f"J{joint.joint}: {joint.reason}" for joint in result.joints if joint.reason),
            f"Outliers: poses {outliers}" if outliers else None,
            f"Tilt of bearings: {tilt_sentence(result)}",
            f"Torque-dependent stiffness: {result.torque_dependence.sentence}",
            f"Report: {folder / 'report.html'}",
        )
    )


def print_comparison(names: Sequence[str], joints: Sequence[JointComparison]) -> None:
    """Print the joints of several sets side by side, and beside the drivetrains' model."""
    several = ("all sets",) if len(names) > 1 else ()
    columns = (*names, *several, "model")
    rows, tilts = [], []
    for joint in joints:
        name, pooled = f"J{joint.joint}", [(joint.pooled, joint.pooled_sd) for _ in several]
        cells = (
            DASH if value is None or sd is None else f"{decades(value)} ± {decades(sd, 2)}"
            for value, sd in [*zip(joint.stiffness, joint.sd, strict=True), *pooled]
        )
        rows.append((name, *cells, decades(joint.model)))
        if any(joint.tilt) or joint.modelled_tilt is not None:
            cells = (decades(each) for each in (*joint.tilt, *(None for _ in several)))
            tilts.append((f"{name}, tilt", *cells, decades(joint.modelled_tilt)))
    print_table(("", *columns), rows + tilts, title="Joint stiffness side by side", numbers=columns)
    print_lines(
        f"J{joint.joint}: {told}."
        for joint in joints
        for told in (describe_spread(names, joint), describe_difference(joint))
        if told
    )


_MARKER_STYLES = (
    ("stiffness", "identified, 95 % confidence interval", "o", svg.BLUE, 6),
    ("least_squares", "ordinary least squares", "d", svg.ORANGE, 4),
    ("nominal", "nominal", "|", svg.VERMILLION, 14),
)


@svg.figure_style()
def stiffness_figure(result: StaticStiffness) -> Figure:
    """Plot the stiffness of every joint with its confidence interval, and nominal values."""
    shown = [joint for joint in result.joints if joint.lower is not None]
    figure, axes = svg.subplots(0.9 + 0.42 * max(len(result.joints), 2))
    values = [
        each
        for j in shown
        for each in (j.lower, j.upper, j.stiffness, j.least_squares, j.nominal)
        if each is not None
    ] or [1.0]
    low, high = 0.7 * min(values), 1.4 * max(values)
    for joint in shown:
        row, start, end = joint.joint, joint.lower or low, joint.upper or high
        axes.plot([start, end], [row, row], color=svg.BLUE, linewidth=2.2, solid_capstyle="butt")
        if joint.upper is None:
            axes.plot(high, row, marker=">", color=svg.BLUE, markersize=6, clip_on=False)
    for name, label, marker, colour, size in _MARKER_STYLES:
        known = [(getattr(j, name), j.joint) for j in result.joints if getattr(j, name)]
        if known:
            x, y = zip(*known, strict=True)
            axes.plot(x, y, marker, color=colour, ms=size, mew=1.8, label=label, zorder=3)
    for joint in result.joints:
        if joint.lower is None:
            text = "not loaded by these poses" if joint.status == "not_loaded" else "confounded"
            axes.text(low * 1.03, joint.joint, text, va="center", fontsize=8, color=svg.GREY)
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


@svg.figure_style()
def prediction_figure(result: StaticStiffness) -> Figure:
    """Plot measured displacements against leave-one-out predictions, every pose."""
    measured = result.rows.displacement
    factor, unit = scale(float(np.max(np.abs(measured))), "m")
    outlying = np.zeros(len(measured), dtype=bool)
    outlying[[pose - 1 for pose in result.outliers]] = True
    figure, grid = svg.subplots(3.5, 1, 3)
    for i, (axes, name) in enumerate(zip(grid, "xyz", strict=True)):
        x, y = factor * result.left_out[:, i], factor * measured[:, i]
        ends = [min(x.min(), y.min()), max(x.max(), y.max())]
        axes.plot(ends, ends, color=svg.GREY, linewidth=0.9)
        axes.plot(
            x[~outlying], y[~outlying], "o", color=svg.BLUE, markersize=4, label="pose left out"
        )
        if outlying.any():
            axes.plot(
                x[outlying], y[outlying], "s", color=svg.VERMILLION, markersize=5, label="outlier"
            )
        axes.set_title(f"{name} [{unit}]")
        axes.set_xlabel("predicted")
    grid[0].set_ylabel("measured")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", ncols=2, bbox_to_anchor=(0.03, -0.05))
    figure.subplots_adjust(left=0.06, right=0.99, wspace=0.2)
    return figure


@svg.figure_style()
def poses_figure(result: StaticStiffness) -> Figure:
    """Plot the leave-one-out error of every pose, and that of the nominal stiffness."""
    measured = result.rows.displacement
    error = np.linalg.norm(measured - result.left_out, axis=1)
    factor, unit = scale(float(np.max(error)), "m")
    pose = np.arange(1, len(measured) + 1)
    figure, axes = svg.subplots(2.9)
    colours = [svg.VERMILLION if k in result.outliers else svg.BLUE for k in pose.tolist()]
    axes.bar(pose, factor * error, width=0.7, color=colours, label="identified, pose left out")
    nominal = result.source.stiffness
    if nominal is not None:
        predicted = result.rows.compliance_columns() @ (1.0 / nominal)
        before = np.linalg.norm(measured - predicted, axis=1)
        axes.plot(
            pose, factor * before, "_", color=svg.ORANGE, markersize=9, mew=2.0, label="nominal"
        )
    noise = factor * np.sqrt(3.0) * result.scale
    axes.axhline(noise, color=svg.GREY, linewidth=0.9, linestyle=(0, (4, 2)), label="typical error")
    axes.set_xlabel("pose")
    axes.set_ylabel(f"error [{unit}]")
    axes.margins(x=0.01)
    axes.grid(visible=False, axis="x")
    figure.legend(loc="upper left", ncols=3, bbox_to_anchor=(0.03, -0.1))
    figure.subplots_adjust(left=0.06, right=0.99)
    return figure


@svg.figure_style()
def models_figure(result: StaticStiffness) -> Figure:
    """Plot the error on fitted and on left-out poses, per model of the wind-up."""
    models = result.torque_dependence.models
    factor, unit = scale(max(model.left_out for model in models), "m")
    figure, axes = svg.subplots(0.8 + 0.36 * len(models))
    for row, model in enumerate(models):
        colour = svg.GREEN if model.candidate else svg.SKY
        axes.plot([factor * model.fit, factor * model.left_out], [row, row], color=colour, zorder=1)
        axes.plot(factor * model.fit, row, "o", mfc="white", mec=colour, markersize=6)
        axes.plot(factor * model.left_out, row, "o", color=colour, markersize=7)
    axes.axvline(
        factor * models[0].left_out, color=svg.GREY, linewidth=0.9, linestyle=(0, (4, 2)), zorder=0
    )
    axes.set_yticks(range(len(models)), [model.name for model in models])
    axes.set_ylim(len(models) - 0.5, -0.5)
    axes.set_xlabel(
        f"root mean square error [{unit}]: open symbols fitted poses, full symbols left-out poses"
    )
    axes.grid(visible=False, axis="y")
    figure.subplots_adjust(left=0.2, right=0.98)
    return figure


@svg.figure_style()
def secant_figure(result: StaticStiffness) -> Figure:
    """Plot the secant stiffness of every joint at small, middle and large torque."""
    secant = result.torque_dependence.secant
    figure, axes = svg.subplots(3.0)
    colours = (svg.BLUE, svg.VERMILLION, svg.GREEN, svg.ORANGE, svg.SKY, svg.GREY)
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
