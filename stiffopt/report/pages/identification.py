"""report.html and terminal output of an identified joint stiffness with confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.identification.comparison import JointComparison, describe_difference
from stiffopt.identification.result import JointStiffness, StaticStiffness
from stiffopt.report.common.page import Filters, PageFigures, write_page
from stiffopt.report.common.terminal import print_lines, print_table
from stiffopt.report.common.text import DASH, decades, si
from stiffopt.report.pages.identification_figures import (
    models_figure,
    poses_figure,
    prediction_figure,
    secant_figure,
    stiffness_figure,
)

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
        f"{si(result.tilt[-1].left_out, 'm', 3)} in place of {si(result.errors.left_out, 'm', 3)}."
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
        f"J{joint.joint}: {told}." for joint in joints if (told := describe_difference(joint))
    )
