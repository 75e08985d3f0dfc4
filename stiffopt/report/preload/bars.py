"""Requirements of a preload study with their utilisation as bars."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.report.common.quantities import percent
from stiffopt.report.preload.names import MARK, owner_name, quantity
from stiffopt.report.solve.tables import Table

if TYPE_CHECKING:
    from stiffopt.preload.utilisation import UtilisationRow

# Kinds of rows whose value must be at least the limit; all others at most.
_AT_LEAST = ("slip safety", "least preload", "joint stiffness")
_KEY = "key pressure"
# With more rows than this a matrix gives the overview.
_SHOWN_ROWS = 14


@dataclass(frozen=True)
class BarRow:
    """One requirement with its utilisation as a bar.

    Parameters
    ----------
    owner, kind, case, value, limit, percent : str
    width : float
        Of the bar [%], at most 100.
    state : {"over", "active", ""}
    estimated : bool
        Whether the limit is.
    """

    owner: str
    kind: str
    case: str
    value: str
    limit: str
    percent: str
    width: float
    state: str
    estimated: bool


@dataclass(frozen=True)
class Matrix:
    """Utilisation of every requirement by owner and kind, each in its worst load case.

    Parameters
    ----------
    kinds : tuple of str
    rows : tuple of (str, tuple of BarRow or None)
        Owner, and one cell a kind.
    """

    kinds: tuple[str, ...]
    rows: tuple[tuple[str, tuple[BarRow | None, ...]], ...]


def utilisation_bars(rows: Sequence[UtilisationRow]) -> list[BarRow]:
    """Requirements to look at first, most used first.

    The worst load case of each kind and owner; where these are too many, the worst owner of each
    kind.
    """
    shown = _worst(rows, lambda row: (row.kind, row.element, row.joint))
    if len(shown) > _SHOWN_ROWS:
        shown = _worst(rows, lambda row: row.kind)
    return [bar(row) for row in sorted(shown, key=lambda row: -row.utilisation)]


def utilisation_matrix(rows: Sequence[UtilisationRow]) -> Matrix | None:
    """Overview where there are too many requirements for a list; else None.

    Keys have but one requirement, so the worst of them stands for all.
    """
    worst = _worst(rows, lambda row: (row.kind, row.element, row.joint))
    if len(worst) <= _SHOWN_ROWS:
        return None
    kinds = tuple(dict.fromkeys(row.kind for row in worst))
    keys = [row for row in worst if row.kind == _KEY]
    if keys:
        most = max(keys, key=lambda row: row.utilisation)
        worst = [row for row in worst if row.kind != _KEY or row is most]
    cells: dict[str, dict[str, BarRow]] = {}
    for row in worst:
        name = owner_name(row)
        if row.kind == _KEY and len(keys) > 1:
            name = f"{name}, worst of {len(keys)} keys"
        cells.setdefault(name, {})[row.kind] = bar(row)
    lines = tuple((name, tuple(own.get(kind) for kind in kinds)) for name, own in cells.items())
    return Matrix(kinds, lines)


def _worst(
    rows: Sequence[UtilisationRow], owner: Callable[[UtilisationRow], Hashable]
) -> list[UtilisationRow]:
    worst: dict[Hashable, UtilisationRow] = {}
    for row in rows:
        key = owner(row)
        if key not in worst or row.utilisation > worst[key].utilisation:
            worst[key] = row
    return list(worst.values())


def bar(row: UtilisationRow) -> BarRow:
    """Text and bar of one requirement."""
    used = row.utilisation
    finite = bool(np.isfinite(used))
    sign = "≥" if row.kind in _AT_LEAST else "≤"
    value = quantity(row.value, row.unit, 3) if np.isfinite(row.value) else "no load"
    return BarRow(
        owner=owner_name(row),
        kind=row.kind,
        case=row.case,
        value=value,
        limit=f"{sign} {quantity(row.limit, row.unit, 3)}",
        percent=percent(used, 3) if finite else "above all bounds",
        width=round(100 * min(used, 1.0), 1) if finite else 100.0,
        state="over" if not row.kept else "active" if row.active else "",
        estimated=row.provenance == "estimated",
    )


def limit_sources(rows: Sequence[UtilisationRow]) -> Table:
    """Where every kind of limit comes from; estimated ones marked."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        if row.source:
            owners = found.setdefault((row.kind, row.provenance, row.source), [])
            if owner_name(row) not in owners:
                owners.append(owner_name(row))
    cells = tuple(
        (
            f"{kind}{MARK if provenance == 'estimated' else ''}",
            _few(owners),
            source,
        )
        for (kind, provenance, source), owners in found.items()
    )
    return Table(("limit", "of", "where from"), cells)


def _few(names: Sequence[str], most: int = 3) -> str:
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[: most - 1])} and {len(names) - most + 1} more"
