"""What `stiffopt preload` prints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stiffopt.report.common.terminal import print_lines, print_table
from stiffopt.report.common.text import DASH, si, significant
from stiffopt.report.preload.cautions import cautions
from stiffopt.report.preload.words import (
    active_limits_sentence,
    active_limits_text,
    fasteners,
    headline,
    readable,
    stiffness_sentence,
)

if TYPE_CHECKING:
    from stiffopt.preload.problem import FreeElement
    from stiffopt.preload.study import PreloadStudy

_CONNECTION_COLUMNS = (
    "connection",
    "fasteners",
    "preload",
    "at least",
    "tightening torque",
    "used",
    "set by",
)


def print_study(study: PreloadStudy, folder: Path) -> None:
    """What to tighten to, what binds, how much of each limit is used, and where the files are."""
    problem, solution = study.problem, study.solution
    if solution.status.usable:
        print_lines(
            (
                f"{solution.status}: {headline(problem, solution)}.",
                active_limits_sentence(problem, solution) or None,
                stiffness_sentence(problem, solution) or None,
            )
        )
        print_table(
            _CONNECTION_COLUMNS, [_connection_row(study, element) for element in problem.elements]
        )
    else:
        print_lines([f"{solution.status}: {solution.message}"])
    print_lines(
        (
            f"Catalogue: {study.choice.message}" if study.choice is not None else None,
            study.motion.note if study.motion is not None else None,
            *(f"Note: {note}" for note in solution.notes),
            *(f"Warning: {each}" for each in cautions(problem, solution)),
            f"Report: {folder / 'report.html'}",
        )
    )


def _connection_row(study: PreloadStudy, element: FreeElement) -> tuple[str, ...]:
    """One connection."""
    solution, key = study.solution, element.key
    preload, torque = solution.preloads[key], solution.tightening[key]
    # What no preload changes is not used up by it, nor is a warning.
    fixed = {limit.name for limit in element.limits if not limit.depends_on_preload}
    own = [r for r in solution.rows if r.element == key and r.binding and r.kind not in fixed]
    used = max(own, key=lambda r: r.utilisation)
    return (
        readable(key),
        fasteners(element),
        si(preload, "kN"),
        si(float(element.least(preload)), "kN"),
        DASH
        if torque is None
        else f"{si(torque.nominal, 'N m', 3)} ({significant(torque.lower, 3)} at least)",
        f"{100 * used.utilisation:.0f} % of {used.kind}",
        active_limits_text(solution, key, element.joint),
    )
