"""Outcome of a catalogue search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from stiffopt.preload.candidates import CatalogueDesign
from stiffopt.preload.ledger import SearchProof
from stiffopt.preload.problem import PreloadProblem
from stiffopt.preload.solution import PreloadSolution, Stopper
from stiffopt.result.status import SolveStatus


@dataclass(frozen=True, kw_only=True)
class TableRow:
    """Best torque for one kind of bolts of one element, all other elements as chosen.

    Parameters
    ----------
    design : CatalogueDesign
        With the best torque that meets everything; where there is none, the one that comes
        nearest to its limits.
    objective : float
        Of the study with this design, in its unit; nan where nothing was chosen at all.
    stopper : str
        Limit or requirement that stops all torques; "" where the design is feasible.
    utilisation : float
        Of the limit that is used most by this connection [-].
    torques : int
        Number of torques that there are for these bolts.
    chosen : bool
    """

    design: CatalogueDesign
    objective: float
    stopper: str
    utilisation: float
    torques: int
    chosen: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class CatalogueChoice:
    """Best design that the catalogue has for a study, with the proof.

    Parameters
    ----------
    status : SolveStatus
        optimal: nothing in the catalogue is better. acceptable: the best that was found; what is
        possible is bounded by `proof.bound`. infeasible: the catalogue has nothing for this study,
        see `stoppers`. iteration_limit: nothing was found before the search ended.
    message : str
    designs : mapping of element key to CatalogueDesign
        Empty where the catalogue has nothing.
    objective : float
        Of the study, in its unit; nan where there is no design.
    solution : PreloadSolution or None
        The chosen design by the exact law: rows, stiffness, deflection.
    continuous : PreloadSolution or None
        Best real numbers for the preloads of the same bolts.
    gap : float
        By how much the catalogue design is worse than those [-].
    problem : PreloadProblem or None
        The study with the chosen bolts in the robot.
    table : tuple of TableRow
        One for each element, size, grade and count.
    proof : SearchProof
        Account of the search for the best objective.
    tie_proofs : tuple of SearchProof
        Accounts of the searches among designs of equal objective, where there were any.
    stoppers : tuple of Stopper
        Why the catalogue has nothing; empty where it has.
    """

    status: SolveStatus
    message: str
    designs: Mapping[str, CatalogueDesign]
    objective: float
    solution: PreloadSolution | None
    continuous: PreloadSolution | None
    gap: float
    problem: PreloadProblem | None
    table: tuple[TableRow, ...]
    proof: SearchProof
    tie_proofs: tuple[SearchProof, ...] = ()
    stoppers: tuple[Stopper, ...] = ()
