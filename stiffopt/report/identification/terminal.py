"""What `stiffopt identify-stiffness` prints."""

from __future__ import annotations

from pathlib import Path

from stiffopt.identification.result import StaticStiffness
from stiffopt.report.common.terminal import print_lines, print_table
from stiffopt.report.common.text import DASH, decades
from stiffopt.report.identification.page import error_sentence, headline, interval, status_words

_NUMBER_COLUMNS = ("stiffness", "standard deviation", "95 % interval", "nominal")
_DEVIATION_COLUMN = "softer than nominal by (standard deviations)"


def print_static(result: StaticStiffness, folder: Path) -> None:
    """Stiffness of the joints, errors, the verdict on torque dependence, where the files are."""
    print_lines([f"{headline(result)}. {error_sentence(result)}"])
    rows = [
        (
            f"J{joint.joint}",
            status_words(joint),
            decades(joint.stiffness),
            decades(joint.sd, 2),
            interval(joint.lower, joint.upper),
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
            f"Poses that do not fit the others: {outliers}" if outliers else None,
            f"Torque-dependent stiffness: {result.torque_dependence.sentence}",
            f"Report: {folder / 'report.html'}",
        )
    )
