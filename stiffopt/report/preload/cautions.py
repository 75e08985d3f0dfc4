"""What is beyond a warning: no design is stopped by it, and which of the two counts is said."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from stiffopt.connection import BoltedFlange
from stiffopt.drivetrain import catalogue
from stiffopt.errors import is_factor
from stiffopt.report.common.text import listed, percent
from stiffopt.report.preload.words import owner_name

if TYPE_CHECKING:
    from stiffopt.fastening.utilisation_row import UtilisationRow
    from stiffopt.preload.problem import PreloadProblem
    from stiffopt.preload.solution import PreloadSolution

# Connections that a sentence names.
_MAX_NAMED_CONNECTIONS = 3


def cautions(problem: PreloadProblem, solution: PreloadSolution) -> list[str]:
    """A sentence for each kind of warning that a design to use exceeds, worst connection first.

    And one on the friction of stainless bolts, where there are any.
    """
    if not solution.status.usable:
        return []
    over: dict[str, list[UtilisationRow]] = {}
    for row in sorted(solution.rows, key=lambda row: -row.utilisation):
        if not row.binding and row.utilisation > 1.0:
            over.setdefault(row.kind, []).append(row)
    return [*(_warning_sentence(own) for own in over.values()), *_stainless_friction(problem)]


def _stainless_friction(problem: PreloadProblem) -> Iterator[str]:
    """Stainless threads gall: their friction without a lubricant is not one to count on."""
    grades = {
        flange.bolt.grade
        for flange in (element.stage.element for element in problem.elements)
        if isinstance(flange, BoltedFlange) and flange.bolt is not None
    }
    stainless = sorted(grade for grade in grades if not catalogue.bolt_grade(grade).heat_treated)
    if stainless:
        friction = problem.tightening.thread_friction
        yield (
            f"bolts {listed(stainless)} seize in threads that run dry: thread_friction ="
            f" {friction:g} must be that of the lubricant in use. State it in [tightening], with"
            " friction_highest where it scatters."
        )


def _warning_sentence(rows: Sequence[UtilisationRow]) -> str:
    owners = list(dict.fromkeys(owner_name(row) for row in rows))
    more = len(owners) - _MAX_NAMED_CONNECTIONS
    where = (
        listed(owners)
        if more < 1
        else f"{', '.join(owners[:_MAX_NAMED_CONNECTIONS])} and {more} more"
    )
    worst = rows[0]
    used = percent(worst.utilisation, 3) if math.isfinite(worst.utilisation) else "any multiple"
    of = "" if is_factor(worst.utilisation) else " of"
    return (
        f"{worst.kind} is at {used}{of} its limit in {where}. It stops no"
        f" design: {worst.warns}. To change: {worst.remedy}."
    )
