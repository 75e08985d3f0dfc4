"""What is beyond a warning: no design is stopped by it, and which of the two counts is said."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from stiffopt.errors import is_factor
from stiffopt.report.common.text import listed, percent
from stiffopt.report.preload.words import owner_name

if TYPE_CHECKING:
    from stiffopt.fastening.utilisation_row import UtilisationRow
    from stiffopt.preload.solution import PreloadSolution

# Connections that a sentence names.
_NAMED = 3


def cautions(solution: PreloadSolution) -> list[str]:
    """A sentence for each kind of warning that a design to use exceeds, worst connection first."""
    if not solution.status.usable:
        return []
    over: dict[str, list[UtilisationRow]] = {}
    for row in sorted(solution.rows, key=lambda row: -row.utilisation):
        if not row.binding and row.utilisation > 1.0:
            over.setdefault(row.kind, []).append(row)
    return [_said(own) for own in over.values()]


def _said(rows: Sequence[UtilisationRow]) -> str:
    owners = list(dict.fromkeys(owner_name(row) for row in rows))
    more = len(owners) - _NAMED
    where = listed(owners) if more < 1 else f"{', '.join(owners[:_NAMED])} and {more} more"
    worst = rows[0]
    used = percent(worst.utilisation, 3) if math.isfinite(worst.utilisation) else "any multiple"
    of = "" if is_factor(worst.utilisation) else " of"
    return (
        f"{worst.kind} is at {used}{of} its limit in {where}. It stops no"
        f" design: {worst.warns}. To change: {worst.remedy}."
    )
