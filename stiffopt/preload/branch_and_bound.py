"""Exact search for the best combination of catalogue designs, one design an element.

Costs add up over the elements, and so do the amounts in which a combination uses each row (the
compliance of a joint, a bound of the tool's deflection). Partial combinations are dropped where
what they have used and the least that the rest can use break a row, or where what they cost and
the least that the rest can cost are no better than the best found. Elements of different joints
hang together by few rows or none, so the best of each joint alone is the bound for the joints to
come; rows that join them are priced into the bound as well (Lagrange).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.preload.ledger import Ledger, SearchProof
from stiffopt.preload.menus import ROUNDING, Menu, Rows, dominated
from stiffopt.preload.search_bounds import (
    least_amounts,
    least_costs,
    least_peak,
    least_peaks,
    prices,
    room_value,
)

DOMINATED = "dominated: another design costs no more and is as stiff in every load case"
# Partial and whole combinations that a search looks at before it gives up the proof: half a minute.
NODES = 200_000
NO_BETTER = "bound: no better than the best found"


Amounts = Callable[[tuple[int, ...]], np.ndarray]


@dataclass(frozen=True, eq=False)
class Found:
    """End of a search.

    Parameters
    ----------
    picks : tuple of int or None
        Design of each element, as a position in the menus given; None: no combination will do.
    value : float
        Objective.
    proof : SearchProof
    stoppers : tuple of str
        Without picks: the rows that ended the search, the most frequent first.
    """

    picks: tuple[int, ...] | None
    value: float
    proof: SearchProof
    stoppers: tuple[str, ...] = ()


class Search:
    """One exact search.

    Parameters
    ----------
    menus : sequence of Menu
        Elements of one block next to each other.
    rows : Rows
    peak : bool
        The objective is the largest of weight times amount over the rows; else the sum of costs,
        and ties are decided.
    amounts : callable, optional
        Amounts of a whole combination, where they are more than the sums of use.
    ledger : Ledger, optional
        Account to go on with; its sizes are those of the menus.
    node_limit : int
        The search gives up the proof beyond.
    """

    def __init__(
        self,
        menus: Sequence[Menu],
        rows: Rows,
        *,
        peak: bool,
        amounts: Amounts | None = None,
        ledger: Ledger | None = None,
        node_limit: int = NODES,
    ) -> None:
        self._given = tuple(menus)
        self._menus = list(menus)
        self._labels = [np.arange(len(m.cost)) for m in menus]
        self._rows, self._peak, self._limit = rows, peak, node_limit
        self._amounts = amounts or self._summed
        self.ledger = ledger or Ledger([len(m.cost) for m in menus])
        self._best: tuple[float, float] = (math.inf, math.inf)
        self._picks: tuple[int, ...] | None = None
        self._floor = -math.inf
        self._open = math.inf
        self._price = np.zeros(len(rows.names))
        self._offered: set[tuple[int, ...]] = set()

    def run(self) -> Found:
        """Search; deterministic."""
        self._drop(self._dominated())
        while self._drop(self._too_much()):
            pass
        if all(self.ledger.sizes):
            self._prepare()
        if all(self.ledger.sizes):
            self._drop(self._hopeless())
        if all(self.ledger.sizes):
            self._suffixes()
            start = self._rows.base.copy()
            self._visit(0, start, 0.0, 0.0, ())
            self._count_offered()
        value = self._best[0]
        bound = value if self.ledger.unvisited == 0 else max(self._floor, min(self._open, value))
        return Found(self._picks, value, self.ledger.proof(bound), self._stoppers())

    # ---- designs that need not be combined

    def _drop(self, reasons: list[dict[int, str]]) -> bool:
        """Take designs off the menus; `reasons` by position. Whether there were any."""
        self.ledger.narrow([Counter(r.values()) for r in reasons])
        for index, gone in enumerate(reasons):
            if gone:
                keep = np.array(
                    [i for i in range(len(self._labels[index])) if i not in gone], dtype=int
                )
                self._menus[index] = self._menus[index].kept(keep)
                self._labels[index] = self._labels[index][keep]
        return any(reasons) and all(self.ledger.sizes)

    def _dominated(self) -> list[dict[int, str]]:
        return [dict.fromkeys(dominated(m, self._peak), DOMINATED) for m in self._menus]

    def _too_much(self) -> list[dict[int, str]]:
        """Designs that break a row even where all others use the least."""
        if not all(self.ledger.sizes):
            return [{} for _ in self._menus]
        found: list[dict[int, str]] = []
        for amounts in least_amounts(self._menus, self._rows):
            over = amounts > self._rows.ends
            broken = np.flatnonzero(over.any(axis=1))
            found.append({int(i): self._rows.names[int(np.argmax(over[i]))] for i in broken})
        return found

    def _hopeless(self) -> list[dict[int, str]]:
        """Designs with which no combination is better than the best found so far."""
        if self._picks is None:
            return [{} for _ in self._menus]
        if self._peak:
            levels = least_peaks(self._menus, self._rows)
        else:
            both = [least_costs(self._menus, self._rows, p) for p in self._tried_prices()]
            levels = [np.max(each, axis=0) for each in zip(*both, strict=True)]
        found: list[dict[int, str]] = []
        for level in levels:
            above = level > self._best[0] + ROUNDING * abs(self._best[0])
            found.append({int(i): NO_BETTER for i in np.flatnonzero(above)})
        return found

    def _prepare(self) -> None:
        """Prices, the best of each block alone, and the first combinations these give."""
        self._spans = self._block_spans()
        self._blocks: list[list[Found]] = []
        if self._peak:
            self._floor = least_peak(self._menus, self._rows)
        elif len(self._menus) > 2:
            self._price = prices(self._menus, self._rows, self._spans)
        if len(self._spans) == 1:
            return
        self._blocks = [self._alone(price) for price in self._tried_prices()]
        for founds in self._blocks:
            blocked = [f for f in founds if f.picks is None and f.proof.complete]
            if blocked:
                self._exclude_all(blocked[0].stoppers[0])
                return
            if all(f.picks is not None for f in founds):
                self._offer(tuple(p for f in founds for p in f.picks or ()))
            if self._peak:
                self._floor = max([self._floor, *(f.proof.bound for f in founds)])

    def _exclude_all(self, reason: str) -> None:
        self.ledger.narrow([Counter({reason: self.ledger.sizes[0]})])

    def _block_spans(self) -> list[slice]:
        spans: list[slice] = []
        for index, menu in enumerate(self._menus):
            if index and menu.block == self._menus[index - 1].block:
                spans[-1] = slice(spans[-1].start, index + 1)
            else:
                spans.append(slice(index, index + 1))
        return spans

    def _alone(self, price: np.ndarray) -> list[Found]:
        """Best designs of each block while all others use the least, at priced costs."""
        least = [m.use.min(axis=0) for m in self._menus]
        founds = []
        for span in self._spans:
            others = sum(u for i, u in enumerate(least) if not span.start <= i < span.stop)
            menus = [replace(m, cost=m.cost + m.use @ price) for m in self._menus[span]]
            search = Search(
                menus,
                replace(self._rows, base=self._rows.base + others),
                peak=self._peak,
                node_limit=self._limit,
            )
            founds.append(search.run())
            self.ledger.nodes += search.ledger.nodes
        return founds

    def _offer(self, picks: tuple[int, ...]) -> None:
        """Take a combination found on the way as the best so far."""
        amounts = self._amounts(self._labelled(picks))
        if (amounts <= self._rows.ends).all():
            key = self._key(amounts, picks)
            if key < self._best:
                self._best, self._picks = key, self._labelled(picks)
                self._offered.add(self._picks)

    def _count_offered(self) -> None:
        """Move the combinations that were offered to the evaluated ones, where the tree cut them.

        They break no row, so it is for the bound that they were cut, or they were left open.
        """
        for _ in self._offered:
            if self.ledger.excluded[NO_BETTER]:
                self.ledger.excluded[NO_BETTER] -= 1
            else:
                self.ledger.unvisited -= 1
            self.ledger.evaluated += 1

    def _labelled(self, picks: Sequence[int]) -> tuple[int, ...]:
        return tuple(int(label[i]) for label, i in zip(self._labels, picks, strict=True))

    def _summed(self, picks: tuple[int, ...]) -> np.ndarray:
        amounts = self._rows.base.copy()
        for menu, i in zip(self._given, picks, strict=True):
            amounts = amounts + menu.use[i]
        return amounts

    def _key(self, amounts: np.ndarray, picks: Sequence[int]) -> tuple[float, float]:
        if self._peak:
            return float((amounts * self._rows.weight).max()), 0.0
        cost = tie = 0.0
        for menu, i in zip(self._menus, picks, strict=True):
            cost += float(menu.cost[i])
            tie += float(menu.tie[i])
        return cost, tie

    # ---- the tree

    def _suffixes(self) -> None:
        """What the elements from each one on use, cost and count at least."""
        count, rows = len(self._menus), len(self._rows.names)
        self._rest = np.zeros((count + 1, rows))
        self._ties = np.zeros(count + 1)
        self._below = [1] * (count + 1)
        for i in reversed(range(count)):
            menu = self._menus[i]
            self._rest[i] = self._rest[i + 1] + menu.use.min(axis=0)
            self._ties[i] = self._ties[i + 1] + menu.tie.min()
            self._below[i] = self._below[i + 1] * len(menu.cost)
        room = np.abs(self._rows.cap - self._rows.base)
        self._strain = np.where(np.isfinite(room) & (room > 0.0), 1.0 / np.maximum(room, 1e-300), 0)
        self._costs = []
        if self._peak:
            return
        for price in self._tried_prices():
            room_worth = room_value(self._rows, price)
            self._costs.append((price, room_worth, self._cost_suffix(price)))

    def _tried_prices(self) -> list[np.ndarray]:
        """No price at all, and that of the linear relaxation."""
        none = np.zeros_like(self._price)
        return [none, self._price] if self._price.any() else [none]

    def _cost_suffix(self, price: np.ndarray) -> np.ndarray:
        suffix = np.zeros(len(self._menus) + 1)
        starts = {span.start: number for number, span in enumerate(self._spans)}
        founds = self._blocks[1 if price.any() else 0] if self._blocks else []
        for i in reversed(range(len(self._menus))):
            menu = self._menus[i]
            suffix[i] = suffix[i + 1] + (menu.cost + menu.use @ price).min()
            if founds and i in starts:
                stop = self._spans[starts[i]].stop
                suffix[i] = max(suffix[i], suffix[stop] + founds[starts[i]].proof.bound)
        return suffix

    def _visit(
        self, depth: int, amounts: np.ndarray, cost: float, tie: float, picks: tuple[int, ...]
    ) -> None:
        menu, below = self._menus[depth], self._below[depth + 1]
        after = amounts + menu.use
        lowest = after + self._rest[depth + 1]
        over = lowest > self._rows.ends
        bad = over.any(axis=1)
        for i in np.flatnonzero(bad):
            self.ledger.excluded[self._rows.names[int(np.argmax(over[i]))]] += below
        costs, ties = cost + menu.cost, tie + menu.tie
        bounds = self._bounds(depth + 1, after, lowest, costs)
        low_ties = ties + self._ties[depth + 1]
        good = np.flatnonzero(~bad)
        second = menu.use @ self._strain if self._peak else low_ties
        for i in good[np.lexsort((second[good], bounds[good]))]:
            if self.ledger.nodes >= self._limit:
                self.ledger.unvisited += below
                self._open = min(self._open, float(bounds[i]))
                continue
            if not self._improves(float(bounds[i]), float(low_ties[i])):
                self.ledger.excluded[NO_BETTER] += below
                continue
            self.ledger.nodes += 1
            chosen = (*picks, int(i))
            if depth + 1 < len(self._menus):
                self._visit(depth + 1, after[i], float(costs[i]), float(ties[i]), chosen)
            else:
                self._evaluate(chosen)

    def _bounds(
        self, depth: int, after: np.ndarray, lowest: np.ndarray, costs: np.ndarray
    ) -> np.ndarray:
        """Least objective of every design's combinations (m,)."""
        if self._peak:
            return np.asarray(np.maximum((lowest * self._rows.weight).max(axis=1), self._floor))
        bounds = np.full(len(costs), -math.inf)
        for price, room, suffix in self._costs:
            spent = (after - self._rows.base) @ price
            bounds = np.maximum(bounds, costs + spent + suffix[depth] - room)
        return bounds

    def _improves(self, value: float, tie: float) -> bool:
        best, best_tie = self._best
        if best == math.inf:
            return True
        slack = ROUNDING * abs(best)
        if value > best + slack:
            return False
        return value < best - slack or (not self._peak and tie < best_tie)

    def _evaluate(self, picks: tuple[int, ...]) -> None:
        self.ledger.evaluated += 1
        self._offered.discard(self._labelled(picks))
        amounts = self._amounts(self._labelled(picks))
        over = amounts > self._rows.ends
        if over.any():
            self.ledger.broken[self._rows.names[int(np.argmax(over))]] += 1
            return
        key = self._key(amounts, picks)
        if self._improves(*key):
            self._best, self._picks = key, self._labelled(picks)

    def _stoppers(self) -> tuple[str, ...]:
        if self._picks is not None:
            return ()
        counts = self.ledger.excluded + self.ledger.broken
        return tuple(name for name, _ in counts.most_common() if name in self._rows.names)
