"""The best design of a catalogue: bolt size, grade, number and tightening torque, with proof."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.preload.branch_and_bound import Search
from stiffopt.preload.candidates import CatalogueDesign, catalogue_designs
from stiffopt.preload.catalogue_choice import CatalogueChoice as CatalogueChoice
from stiffopt.preload.choice_report import best_torques, element_stoppers, requirement_stoppers
from stiffopt.preload.choice_table import ChoiceTable, choice_table
from stiffopt.preload.conclude import conclude
from stiffopt.preload.ledger import Ledger, SearchProof
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.menus import Rows
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.optimise import Report, levels_of, optimise_preloads, with_worst_instants
from stiffopt.preload.problem import PreloadProblem
from stiffopt.preload.solution import PreloadSolution, Stopper
from stiffopt.result.status import SolveStatus

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Rounds in which worst instants of a motion are looked for anew.
_ROUNDS = 6
# What settles ties may take less trouble than the objective.
_TIE_NODES = 20_000


def choose_design(problem: PreloadProblem, progress: Report | None = None) -> CatalogueChoice:
    """Find the best design that the catalogue has.

    Every bolted flange takes each size, grade and count of `problem.choose` in its present ring;
    set screws stay. All are tightened with standard torques. The result is the best by the
    study's objective of all combinations that keep every limit and requirement by the exact law;
    of equals the one with fewer bolts, then smaller sizes, then lower grades. Where the objective
    is the stiffness of several joints, each joint is the stiffest that leaves the worst as good.

    Parameters
    ----------
    problem : PreloadProblem
        With `choose`. Preloads are one a connection, whatever `individual` says.
    progress : callable, optional
        Called with a `Progress` in every iteration of the solve for the best real numbers.

    Returns
    -------
    CatalogueChoice
        With status infeasible where the catalogue has nothing.
    """
    if problem.choose is None:
        raise ProblemError("No catalogue to choose from. Add [choose] with sizes or counts.")
    problem = replace(problem, individual=False)
    cases = with_worst_instants(problem, problem.load_cases, PreloadModel(problem).design)
    for _ in range(_ROUNDS):
        choice = _Choosing(problem, cases).run()
        if choice.problem is None or choice.solution is None:
            return choice
        more = with_worst_instants(choice.problem, cases, choice.solution.vector)
        if len(more) == len(cases):
            break
        cases = more
    assert choice.problem is not None
    fixed = replace(choice.problem, load_cases=cases, histories=())
    return _beside_real_numbers(choice, optimise_preloads(fixed, progress=progress, throw=False))


@dataclass(frozen=True, eq=False)
class _Best:
    """End of the searches of a study."""

    picks: tuple[int, ...] | None
    proof: SearchProof
    ties: tuple[SearchProof, ...]
    stoppers: tuple[str, ...] = ()


class _Choosing:
    """One search under fixed load cases."""

    def __init__(self, problem: PreloadProblem, cases: tuple[LoadCase, ...]) -> None:
        self.problem, self.cases = problem, cases
        self.model = PreloadModel(problem, cases)
        self.designs = [catalogue_designs(problem, e, cases) for e in problem.elements]
        self.feasible = [[d for d in own if d.feasible] for own in self.designs]
        self.ledger = Ledger([len(own) for own in self.designs])
        self.ledger.narrow(
            [
                Counter(f"{d.stopper}, {d.key}" for d in own if not d.feasible)
                for own in self.designs
            ]
        )

    def run(self) -> CatalogueChoice:
        without = [own for own in self.feasible if not own]
        if without:
            stoppers = element_stoppers(self.model, self.designs)
            return self._nothing(stoppers, self.ledger.proof(float("inf")), None)
        table = choice_table(self.model, self.feasible, levels_of(self.model))
        best = _search(self.problem, table, self.ledger)
        if best.picks is None:
            stoppers = requirement_stoppers(self.model, table, best.stoppers)
            return self._nothing(stoppers, best.proof, table)
        return self._chosen(table, best, best.picks)

    def _chosen(self, table: ChoiceTable, best: _Best, picks: tuple[int, ...]) -> CatalogueChoice:
        chosen = [own[i] for own, i in zip(self.feasible, picks, strict=True)]
        study = replace(self.problem, robot=_with_designs(self.problem.robot, chosen), choose=None)
        status = SolveStatus.OPTIMAL if best.proof.complete else SolveStatus.ACCEPTABLE
        solution = conclude(
            PreloadModel(study, self.cases), np.array([d.preload for d in chosen]), status
        )
        return CatalogueChoice(
            status=solution.status,
            message=_account(best.proof, chosen, solution),
            designs={d.key: d for d in chosen},
            objective=solution.objective,
            solution=solution,
            continuous=None,
            gap=float("nan"),
            problem=study,
            table=best_torques(self.model, self.designs, table, picks),
            proof=best.proof,
            tie_proofs=best.ties,
        )

    def _nothing(
        self, stoppers: tuple[Stopper, ...], proof: SearchProof, table: ChoiceTable | None
    ) -> CatalogueChoice:
        reasons = " ".join(str(stop) for stop in stoppers)
        status = SolveStatus.INFEASIBLE if proof.complete else SolveStatus.ITERATION_LIMIT
        begin = (
            "The catalogue has nothing for this study."
            if proof.complete
            else ("The search ended before it found a design.")
        )
        return CatalogueChoice(
            status=status,
            message=f"{begin} {reasons}".strip(),
            designs={},
            objective=float("nan"),
            solution=None,
            continuous=None,
            gap=float("nan"),
            problem=None,
            table=best_torques(self.model, self.designs, table, None),
            proof=proof,
            stoppers=stoppers,
        )


def _search(problem: PreloadProblem, table: ChoiceTable, ledger: Ledger) -> _Best:
    """Search for the objective, then among equals."""
    if problem.objective == "total_preload":
        found = Search(
            table.menus, table.rows, peak=False, amounts=table.amounts, ledger=ledger
        ).run()
        return _Best(found.picks, found.proof, (), found.stoppers)
    first = Search(table.menus, table.rows, peak=True, amounts=table.amounts, ledger=ledger).run()
    if first.picks is None:
        return _Best(None, first.proof, (), first.stoppers)
    # Each goal that is reached becomes a requirement of the next; the last is what decides ties.
    rows, picks, ties = table.rows, first.picks, []
    value = first.value
    for weight in _further_goals(problem, table):
        rows = replace(rows, cap=_kept(rows, value), weight=weight)
        found = Search(
            table.menus, rows, peak=True, amounts=table.amounts, node_limit=_TIE_NODES
        ).run()
        picks, value = found.picks or picks, found.value
        ties.append(found.proof)
    rows = replace(rows, cap=_kept(rows, value))
    menus = [replace(m, cost=m.tie, tie=m.cost) for m in table.menus]
    found = Search(menus, rows, peak=False, amounts=table.amounts, node_limit=_TIE_NODES).run()
    return _Best(found.picks or picks, first.proof, (*ties, found.proof))


def _further_goals(problem: PreloadProblem, table: ChoiceTable) -> list[np.ndarray]:
    """Weights of the rows of each joint alone, where several are to be stiff."""
    if problem.objective != "joint_stiffness" or len(problem.joints) == 1:
        return []
    own = [np.array([j == joint for j in table.joints]) for joint in problem.joints]
    return [np.where(mask, table.rows.weight, 0.0) for mask in own]


def _kept(rows: Rows, value: float) -> np.ndarray:
    """Caps that keep the peak at this value."""
    counts = rows.weight > 0.0
    own = np.where(counts, value / np.where(counts, rows.weight, 1.0), np.inf)
    return np.asarray(np.minimum(rows.cap, own))


def _with_designs(robot: Robot, chosen: list[CatalogueDesign]) -> Robot:
    """Copy of the robot with the chosen bolts, at their largest preloads."""
    chains = list(robot.chains)
    for design in chosen:
        chain = chains[design.joint - 1]
        assert chain is not None
        name = design.stage.element.name
        stages = tuple(design.stage if s.element.name == name else s for s in chain.stages)
        chains[design.joint - 1] = replace(chain, stages=stages)
    return replace(robot, chains=tuple(chains))


def _account(proof: SearchProof, chosen: list[CatalogueDesign], solution: PreloadSolution) -> str:
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


def _beside_real_numbers(choice: CatalogueChoice, continuous: PreloadSolution) -> CatalogueChoice:
    """Compare with the best preloads of the same bolts, were every torque possible."""
    if not continuous.status.usable:
        return replace(choice, continuous=continuous)
    assert choice.problem is not None
    worse = choice.objective - continuous.objective
    if choice.problem.objective == "joint_stiffness":
        worse = -worse
    gap = worse / continuous.objective
    if choice.proof.complete:
        what = "Any torque instead of a standard one would gain"
    else:
        what = "With its bolts and any torque the design would be better by"
    text = f"{choice.message} {what} {100 * max(gap, 0.0):.2f} %."
    return replace(choice, continuous=continuous, gap=gap, message=text)
