"""Bounds of what combinations of catalogue designs can reach, without combining them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stiffopt.preload.menus import Menu, Rows


def least_amounts(menus: Sequence[Menu], rows: Rows) -> list[np.ndarray]:
    """Least amounts of the combinations with each design, (m, rows) for every element."""
    least = np.array([m.use.min(axis=0) for m in menus])
    whole = rows.base + least.sum(axis=0)
    return [whole - own + menu.use for menu, own in zip(menus, least, strict=True)]


def least_peaks(menus: Sequence[Menu], rows: Rows) -> list[np.ndarray]:
    """Least peak of the combinations with each design, (m,) for every element."""
    return [(amounts * rows.weight).max(axis=1) for amounts in least_amounts(menus, rows)]


def least_costs(menus: Sequence[Menu], rows: Rows, price: np.ndarray) -> list[np.ndarray]:
    """Least cost of the combinations with each design, (m,) for every element.

    Parameters
    ----------
    menus : sequence of Menu
    rows : Rows
    price : array (rows,)
        Not negative; use is paid for, and what the rows leave is given back.
    """
    priced = [m.cost + m.use @ price for m in menus]
    whole = sum(float(p.min()) for p in priced) - room_value(rows, price)
    return [whole - p.min() + p for p in priced]


def room_value(rows: Rows, price: np.ndarray) -> float:
    """Price of all that the rows leave to the elements."""
    priced = price > 0.0
    return float(price[priced] @ (rows.ends - rows.base)[priced])


def least_peak(menus: Sequence[Menu], rows: Rows) -> float:
    """Bound of the peak that takes all rows together.

    A combination of the value v has only designs that allow a value up to v by themselves. So v is
    at least some such level up to which every row can be kept, and at least the peak that is
    possible with the designs up to there; the former grows with the level, the latter falls.
    """
    levels = least_peaks(menus, rows)
    steps = np.unique(np.concatenate(levels))

    def bound(index: int) -> tuple[float, float]:
        least = rows.base.copy()
        for menu, level in zip(menus, levels, strict=True):
            within = menu.use[level <= steps[index]]
            if not len(within):
                return float(steps[index]), math.inf
            least = least + within.min(axis=0)
        kept = bool((least <= rows.ends).all())
        return float(steps[index]), float((least * rows.weight).max()) if kept else math.inf

    low, high = 0, len(steps) - 1
    while low < high:
        middle = (low + high) // 2
        level, peak = bound(middle)
        low, high = (low, middle) if peak <= level else (middle + 1, high)
    return min(max(bound(i)) for i in range(max(low - 1, 0), low + 1))


def prices(menus: Sequence[Menu], rows: Rows, spans: Sequence[slice]) -> np.ndarray:
    """Multipliers of the rows in the linear relaxation (rows,); any not negative are valid.

    Parameters
    ----------
    spans : sequence of slice
        Menus of each block. Rows within one of several blocks get no price: the search of the
        block keeps them.
    """
    from scipy.optimize import linprog

    spread = np.array([np.ptp(m.use, axis=0) > 0.0 for m in menus])
    touched = np.array([spread[span].any(axis=0) for span in spans])
    bounding = np.isfinite(rows.cap) & spread.any(axis=0)
    joining = bounding & ((touched.sum(axis=0) > 1) | (len(spans) == 1))
    price = np.zeros(len(rows.names))
    if not joining.any():
        return price
    costs = np.concatenate([m.cost for m in menus])
    uses = np.concatenate([m.use for m in menus])[:, bounding]
    scale, unit = np.abs(uses).max(axis=0), max(float(np.abs(costs).max()), 1e-300)
    result = linprog(
        costs / unit,
        A_ub=(uses / scale).T,
        b_ub=(rows.ends - rows.base)[bounding] / scale,
        A_eq=np.repeat(np.eye(len(menus)), [len(m.cost) for m in menus], axis=1),
        b_eq=np.ones(len(menus)),
        method="highs",
    )
    if result.status == 0:
        price[bounding] = np.maximum(-result.ineqlin.marginals, 0.0) * unit / scale
    return np.where(joining, price, 0.0)
