"""Catalogue designs as numbers that add up, and the rows that bound their sums."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Sums of the same designs in another order are equal; so are ties.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Menu:
    """Designs of one element, as the search sees them.

    Parameters
    ----------
    block : int
        Joint of the element.
    cost : array (m,)
        Adds up to the objective.
    tie : array (m,)
        Adds up to what decides between combinations of equal objective, whole numbers.
    use : array (m, rows)
        Adds up to the least amount in which each row is used.
    order : array (m, columns)
        In which smaller is never worse for any row, whatever the other elements have.
    """

    block: int
    cost: np.ndarray
    tie: np.ndarray
    use: np.ndarray
    order: np.ndarray

    def kept(self, keep: np.ndarray) -> Menu:
        """Menu of some of the designs, by index."""
        return Menu(self.block, self.cost[keep], self.tie[keep], self.use[keep], self.order[keep])


@dataclass(frozen=True, eq=False)
class Rows:
    """What the amounts of use mean.

    Parameters
    ----------
    names : tuple of str
    base : array (rows,)
        Used whatever the elements have.
    cap : array (rows,)
        Largest amount allowed; infinite where there is no requirement.
    weight : array (rows,)
        Of the amount in a peak objective; 0 where it does not count.
    """

    names: tuple[str, ...]
    base: np.ndarray
    cap: np.ndarray
    weight: np.ndarray

    @property
    def ends(self) -> np.ndarray:
        """Largest amounts, with room for rounding."""
        sizes = [np.where(np.isfinite(a), np.abs(a), 0.0) for a in (self.base, self.cap)]
        return np.asarray(self.cap + ROUNDING * np.maximum(*sizes))


def dominated(menu: Menu, peak: bool) -> list[int]:
    """Designs that another one replaces without loss.

    A design replaces another where no column of `order` is larger and, for a sum of costs, the
    cost is smaller, or as large and decides ties no worse. Of designs that replace each other
    the first stays.
    """
    count = len(menu.cost)
    first = np.arange(count)
    no_worse = np.ones((count, count), dtype=bool)
    same = np.ones((count, count), dtype=bool)
    for column in menu.order.T:
        no_worse &= column[:, None] <= column[None, :]
        same &= column[:, None] == column[None, :]
    if not peak:
        cost, tie = menu.cost, menu.tie
        equal = cost[:, None] == cost[None, :]
        no_worse &= (cost[:, None] < cost[None, :]) | (equal & (tie[:, None] <= tie[None, :]))
        same &= equal & (tie[:, None] == tie[None, :])
    replaces = no_worse & (~same | (first[:, None] < first[None, :]))
    return [int(i) for i in np.flatnonzero(replaces.any(axis=0))]
