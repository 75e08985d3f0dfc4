"""What a finished search of the catalogue left out, worked out and left open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stiffopt.preload.catalogue_designs import CatalogueDesign
from stiffopt.preload.solution import PreloadSolution


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
        Combinations that the time limit left open; 0 for a proof.
    nodes : int
        Nodes of the branch-and-bound tree.
    bound : float
        No combination has less than this of what the search minimises: the total preload [N], the
        largest utilisation [-], the largest deflection [m], the largest weight over stiffness [-].
    gap : float
        Distance of the best combination from the solver's bound, relative; infinite where nothing
        was found.
    """

    combinations: int
    excluded: Mapping[str, int]
    evaluated: int
    unvisited: int
    nodes: int
    bound: float
    gap: float

    @property
    def complete(self) -> bool:
        """Whether nothing was left open."""
        return self.unvisited == 0

    @property
    def accounted(self) -> int:
        """Sum of all parts; equal to `combinations`."""
        return sum(self.excluded.values()) + self.evaluated + self.unvisited


def describe_proof(
    proof: SearchProof, chosen: Sequence[CatalogueDesign], solution: PreloadSolution
) -> str:
    """Sentences about the design and the search."""
    bolts = "; ".join(f"{d.key}: {d.label}" for d in chosen)
    if not proof.complete:
        return (
            f"Best design found: {bolts}. It keeps every limit, but the search ended with "
            f"{proof.unvisited:,} of {proof.combinations:,} combinations undecided; none of them "
            f"is below {proof.bound:.6g} in what the search minimises."
        )
    out = sum(proof.excluded.values())
    text = (
        f"Best design of the catalogue: {bolts}. Of {proof.combinations:,} combinations "
        f"{out:,} were excluded by limits and bounds and {proof.evaluated:,} evaluated; none is "
        "better."
    )
    return text if solution.status.usable else f"{text} {solution.message}"
