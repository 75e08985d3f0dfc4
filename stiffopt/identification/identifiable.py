"""Which joints a static set says something of: what it loads, and what it can tell apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Columns below this share of the largest are rounding, not load; combinations likewise.
NEGLIGIBLE = 1e-6
# A joint that moves the tool by less than this share (at equal stiffness) is loaded too little to
# be taken at its word.
WEAK = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Identifiable:
    """What the columns of the compliances allow.

    Parameters
    ----------
    leverage : array (n,)
        Size of each joint's column over the largest [-].
    loaded : array (n,) of bool
    group : array (n,) of int
        Joints with the same number above 0 cannot be told apart; 0: alone.
    kept : array (k,) of int
        Joints of a full-rank choice; one of each confounded direction is missing.
    """

    leverage: np.ndarray
    loaded: np.ndarray
    group: np.ndarray
    kept: np.ndarray


def identifiable(columns: np.ndarray) -> Identifiable:
    """Rank and load of the compliance columns.

    Parameters
    ----------
    columns : array (m, 3, n)
    """
    n = columns.shape[2]
    rows = columns.reshape(-1, n)
    size = np.linalg.norm(rows, axis=0)
    leverage = size / (np.max(size, initial=0.0) or 1.0)
    loaded = leverage > NEGLIGIBLE
    unit = rows / np.where(loaded, size, 1.0)
    group = np.zeros(n, dtype=int)
    here = [int(j) for j in np.flatnonzero(loaded)]
    kept: list[int] = []
    # Stiffer evidence first, so that a weakly loaded joint is the one that is left out.
    for j in sorted(here, key=lambda j: -float(leverage[j])):
        if _left(unit[:, j], unit[:, kept]) > NEGLIGIBLE:
            kept.append(j)
    for j in sorted(set(here) - set(kept)):
        combination = np.linalg.lstsq(unit[:, kept], unit[:, j], rcond=None)[0]
        members = [j, *(k for k, c in zip(kept, combination, strict=True) if abs(c) > 1e-3)]
        known = [int(group[k]) for k in members if group[k]]
        number = min(known) if known else int(group.max()) + 1
        group[np.isin(group, known)] = number
        group[members] = number
    return Identifiable(
        leverage=leverage, loaded=loaded, group=group, kept=np.array(sorted(kept), dtype=int)
    )


def _left(column: np.ndarray, others: np.ndarray) -> float:
    """Size of what the other columns do not explain of a unit column."""
    if not others.shape[1]:
        return 1.0
    combination = np.linalg.lstsq(others, column, rcond=None)[0]
    return float(np.linalg.norm(column - others @ combination))
