"""Account of a search: how many combinations there are, and what became of each."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class SearchProof:
    """Account of a finished search; every combination is in exactly one place.

    Parameters
    ----------
    combinations : int
        Of the designs of all elements.
    excluded : mapping of str to int
        Combinations left out without looking at them one by one, by the limit or rule that does
        it. A combination that several would exclude counts with the first that was applied.
    evaluated : int
        Combinations whose objective and rows were worked out.
    unvisited : int
        Combinations that the limit on nodes left open; 0 for a proof.
    nodes : int
        Partial and whole combinations looked at.
    bound : float
        No combination has less than this of what the search minimises: the total preload [N], the
        largest utilisation [-], the largest deflection [m], the largest weight over stiffness [-].
    """

    combinations: int
    excluded: Mapping[str, int]
    evaluated: int
    unvisited: int
    nodes: int
    bound: float

    @property
    def complete(self) -> bool:
        """Whether nothing was left open."""
        return self.unvisited == 0

    @property
    def accounted(self) -> int:
        """Sum of all parts; equal to `combinations`."""
        return sum(self.excluded.values()) + self.evaluated + self.unvisited


@dataclass
class Ledger:
    """The account while the search runs.

    Parameters
    ----------
    sizes : list of int
        Designs that each element still has.
    broken : Counter
        Rows that evaluated combinations break.
    """

    sizes: list[int]
    excluded: Counter[str] = field(default_factory=Counter)
    broken: Counter[str] = field(default_factory=Counter)
    evaluated: int = 0
    unvisited: int = 0
    nodes: int = 0
    combinations: int = 0

    def __post_init__(self) -> None:
        self.combinations = math.prod(self.sizes)

    def narrow(self, reasons: Sequence[Counter[str]]) -> None:
        """Drop designs of each element, counted by reason.

        A combination belongs to the first of its elements that loses its design.
        """
        for index, counts in enumerate(reasons):
            others = math.prod(self.sizes[:index]) * math.prod(self.sizes[index + 1 :])
            for reason, count in counts.items():
                self.excluded[reason] += count * others
            self.sizes[index] -= counts.total()

    def proof(self, bound: float) -> SearchProof:
        """Close the account."""
        return SearchProof(
            combinations=self.combinations,
            excluded={reason: count for reason, count in self.excluded.items() if count},
            evaluated=self.evaluated,
            unvisited=self.unvisited,
            nodes=self.nodes,
            bound=bound,
        )
