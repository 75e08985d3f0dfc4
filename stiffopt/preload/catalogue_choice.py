"""Optimum design from a catalogue: bolt size, grade, number and torque, with proof."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from stiffopt.drivetrain import catalogue
from stiffopt.errors import ProblemError
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.catalogue_designs import CatalogueDesign, catalogue_designs
from stiffopt.preload.catalogue_programme import ChoiceProgramme, choice_programme
from stiffopt.preload.catalogue_search import (
    CombinationResult,
    CombinationSearch,
    Goal,
    SearchProof,
    describe_proof,
)
from stiffopt.preload.catalogue_table import (
    TableRow,
    best_torques,
    element_stoppers,
    requirement_stoppers,
)
from stiffopt.preload.infeasibility import Stopper
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.optimise import (
    WORST_INSTANT_ROUNDS,
    ProgressReport,
    objective_levels,
    optimise_preloads,
    with_worst_instants,
)
from stiffopt.preload.problem import PreloadProblem
from stiffopt.preload.solution import PreloadSolution, evaluate_design
from stiffopt.result.status import SolveStatus
from stiffopt.robot.robot import Robot

NO_BETTER = "bound: no better than the best found"
NONE_KEEPS_ALL = "bound: no combination keeps all requirements"


@dataclass(frozen=True, kw_only=True, eq=False)
class CatalogueChoice:
    """Optimum catalogue design of a study, with the proof."""

    # optimal: no better design in the catalogue. acceptable: best design found, optimum bounded by
    # `proof.bound`. infeasible: no feasible design, see `stoppers`. iteration_limit: none found
    # before the search ended.
    status: SolveStatus
    message: str
    # By element key: empty if infeasible.
    designs: Mapping[str, CatalogueDesign] = field(default_factory=dict)
    objective: float = float("nan")  # of the study, in its unit; nan without a design
    solution: PreloadSolution | None = None  # the chosen design evaluated by the exact law
    # Optimum preloads of the same bolts at arbitrary torques, and the relative loss against it [-].
    continuous: PreloadSolution | None = None
    gap: float = float("nan")
    problem: PreloadProblem | None = None  # the study with the chosen bolts in the robot
    table: tuple[TableRow, ...]  # one for each element, size, grade and count
    proof: SearchProof  # of the search for the best objective
    # Of the searches among designs of equal objective, if any.
    tie_proofs: tuple[SearchProof, ...] = ()
    stoppers: tuple[Stopper, ...] = ()  # reasons of infeasibility; empty if feasible
    # Optimum of each tightening method and coating, if the study varies them; else empty.
    ways: tuple[TighteningWay, ...] = ()
    cost: float = float("nan")  # in steps, including the tightening method; nan without a design


def choose_design(
    problem: PreloadProblem, progress: ProgressReport | None = None
) -> CatalogueChoice:
    """Find the optimum catalogue design of the best tightening method and coating.

    Sizes, grades and counts of `problem.choose` are combined in the present ring of every bolted
    flange; set screws stay. Torques are standard ones, one preload a connection. The result is the
    best by the objective, or the best of the cheapest if steps have a cost, of all combinations
    that satisfy every limit and requirement by the exact law; of equals the one with fewer bolts,
    then smaller sizes, then lower grades. With the stiffness of several joints as objective, each
    joint is the stiffest that does not lower the least relative stiffness.
    """
    choose = problem.choose
    if choose is None:
        raise ProblemError("No catalogue to choose from. Add [choose] with sizes or counts.")
    problem = replace(problem, individual=False)
    methods, coatings = choose.methods or ("",), choose.coatings or ("",)
    found = []
    for (i, method), (k, coating) in itertools.product(enumerate(methods), enumerate(coatings)):
        way = _tightened(problem.tightening, method, coating)
        own = _choose_for_tightening(replace(problem, tightening=way), progress)
        if choose.cost is not None:
            own = replace(own, cost=own.cost + choose.cost.method * i + choose.cost.coating * k)
        found.append((TighteningWay.of(way, coating, own), own))
    ways = tuple(way for way, _ in found)
    able = [each for each in found if each[1].status.usable]
    if len(found) == 1 or not able:
        return replace(found[-1][1], ways=ways if len(ways) > 1 else ())
    sign = -1.0 if problem.objective == "joint_stiffness" else 1.0
    done, best = min(
        able, key=lambda each: (each[1].cost if choose.cost else 0.0, sign * each[1].objective)
    )
    bolts = f", bolts {done.coating}" if done.coating else ""
    text = f"Tightened by {done.method.replace('_', ' ')}{bolts} at friction {done.friction:g}. "
    return replace(best, ways=ways, message=text + best.message)


def _tightened(tightening: Tightening, method: str, coating: str) -> Tightening:
    """Return the tightening of a study with another method and coating; "" keeps its own."""
    if method:
        tightening = replace(tightening, method=method, scatter=None)  # type: ignore[arg-type]
    if not coating:
        return tightening
    data = catalogue.coating(coating)
    return replace(
        tightening,
        thread_friction=data.least,
        head_friction=data.least,
        friction_highest=data.largest,
    )


def _choose_for_tightening(
    problem: PreloadProblem, progress: ProgressReport | None
) -> CatalogueChoice:
    """Return the optimum design for one tightening method."""
    cases = with_worst_instants(problem, problem.load_cases, PreloadModel(problem).design)
    for _ in range(WORST_INSTANT_ROUNDS):
        choice = _ChoiceSearch(problem, cases).run()
        if choice.problem is None or choice.solution is None:
            return choice
        more = with_worst_instants(choice.problem, cases, choice.solution.vector)
        if len(more) == len(cases):
            break
        cases = more
    assert choice.problem is not None
    fixed = replace(choice.problem, load_cases=cases, histories=())
    return _compare_with_continuous(
        choice, optimise_preloads(fixed, progress=progress, throw=False)
    )


class _ChoiceSearch:
    """Search for the optimum catalogue design under fixed load cases."""

    def __init__(self, problem: PreloadProblem, cases: tuple[LoadCase, ...]) -> None:
        self.problem, self.cases = problem, cases
        self.model = PreloadModel(problem, cases)
        self.designs = [catalogue_designs(problem, e, cases) for e in problem.elements]
        self.feasible = [[d for d in own if d.feasible] for own in self.designs]
        self.excluded: Counter[str] = Counter()
        self.broken: list[dict[int, str]] = []
        self.sizes = [len(own) for own in self.designs]
        self._count_excluded(
            [
                Counter(f"{d.stopper}, {d.key}" for d in own if not d.feasible)
                for own in self.designs
            ]
        )

    def run(self) -> CatalogueChoice:
        if not all(self.feasible):
            stoppers = element_stoppers(self.model, self.designs)
            return self._infeasible_choice(stoppers, self._search_proof(None), None)
        programme = choice_programme(self.model, self.feasible, objective_levels(self.model))
        self.broken = programme.broken_alone()
        self._count_excluded([Counter(each.values()) for each in self.broken])
        search = CombinationSearch(programme)
        founds = (
            _minimise_in_order(search, _ordered_goals(self.problem, programme))
            if all(self.sizes)
            else []
        )
        proof = self._search_proof(founds[0] if founds else None)
        picks = next((f.picks for f in reversed(founds) if f.picks is not None), None)
        if picks is None:
            rows = search.conflicting_rows() if proof.complete else ()
            return self._infeasible_choice(requirement_stoppers(programme, rows), proof, programme)
        return self._feasible_choice(programme, proof, founds[1:], picks)

    def _count_excluded(self, reasons: list[Counter[str]]) -> None:
        """Count excluded combinations by reason, each at the first element that excludes it."""
        for index, counts in enumerate(reasons):
            others = math.prod(self.sizes[:index]) * math.prod(self.sizes[index + 1 :])
            for reason, count in counts.items():
                if others:
                    self.excluded[reason] += count * others
            self.sizes[index] -= counts.total()

    def _search_proof(self, found: CombinationResult | None) -> SearchProof:
        """Return the account of all combinations."""
        evaluated = [
            picks
            for picks in (found.evaluated if found else ())
            if not any(i in broken for i, broken in zip(picks, self.broken, strict=True))
        ]
        left, excluded = math.prod(self.sizes) - len(evaluated), dict(self.excluded)
        complete = found is None or found.complete
        if complete and left:
            excluded[NONE_KEEPS_ALL if found is None or found.picks is None else NO_BETTER] = left
        return SearchProof(
            combinations=math.prod(len(own) for own in self.designs),
            excluded=excluded,
            evaluated=len(evaluated),
            unvisited=0 if complete else left,
            nodes=found.nodes if found else 0,
            bound=found.bound if found else float("inf"),
            gap=found.gap if found else float("inf"),
        )

    def _feasible_choice(
        self,
        programme: ChoiceProgramme,
        proof: SearchProof,
        ties: list[CombinationResult],
        picks: tuple[int, ...],
    ) -> CatalogueChoice:
        chosen = [own[i] for own, i in zip(self.feasible, picks, strict=True)]
        study = replace(self.problem, robot=_with_designs(self.problem.robot, chosen), choose=None)
        status = SolveStatus.OPTIMAL if proof.complete else SolveStatus.ACCEPTABLE
        solution = evaluate_design(
            PreloadModel(study, self.cases), np.array([d.preload for d in chosen]), status
        )
        return CatalogueChoice(
            status=solution.status,
            message=describe_proof(proof, chosen, solution),
            designs={d.key: d for d in chosen},
            objective=solution.objective,
            cost=sum(d.cost for d in chosen),
            solution=solution,
            problem=study,
            table=best_torques(self.model, self.designs, programme, picks),
            proof=proof,
            tie_proofs=tuple(self._search_proof(found) for found in ties),
        )

    def _infeasible_choice(
        self,
        stoppers: tuple[Stopper, ...],
        proof: SearchProof,
        programme: ChoiceProgramme | None,
    ) -> CatalogueChoice:
        reasons = " ".join(str(stop) for stop in stoppers)
        status = SolveStatus.INFEASIBLE if proof.complete else SolveStatus.ITERATION_LIMIT
        begin = (
            "No catalogue design satisfies this study."
            if proof.complete
            else "The search ended before it found a design."
        )
        return CatalogueChoice(
            status=status,
            message=f"{begin} {reasons}".strip(),
            table=best_torques(self.model, self.designs, programme, None),
            proof=proof,
            stoppers=stoppers,
        )


def _ordered_goals(problem: PreloadProblem, programme: ChoiceProgramme) -> list[Goal]:
    """Return the objective and then the tie-breaking goals."""
    cost, tie = Goal(cost=programme.cost), Goal(cost=programme.tie)
    if problem.choose is not None and problem.choose.cost is not None:
        unpriced = replace(problem, choose=replace(problem.choose, cost=None))
        return [Goal(cost=programme.price), *_ordered_goals(unpriced, programme)]
    if problem.objective == "total_preload":
        return [cost, tie]
    weights = [programme.weight]
    if problem.objective == "joint_stiffness" and len(problem.joints) > 1:
        own = [np.array([j == joint for j in programme.joints]) for joint in problem.joints]
        weights += [np.where(mask, programme.weight, 0.0) for mask in own]
    return [*(Goal(weight=weight) for weight in weights), tie, cost]


def _minimise_in_order(search: CombinationSearch, goals: list[Goal]) -> list[CombinationResult]:
    """Minimise the goals in order, up to the first that was not reached."""
    founds = []
    for goal in goals:
        founds.append(search.minimise(goal))
        if not founds[-1].complete or founds[-1].picks is None:
            break
    return founds


def _with_designs(robot: Robot, chosen: list[CatalogueDesign]) -> Robot:
    """Return a copy of the robot with the chosen bolts at their largest preloads."""
    chains = list(robot.chains)
    for design in chosen:
        chain = chains[design.joint - 1]
        assert chain is not None
        name = design.stage.element.name
        stages = tuple(design.stage if s.element.name == name else s for s in chain.stages)
        chains[design.joint - 1] = replace(chain, stages=stages)
    return replace(robot, chains=tuple(chains))


def _compare_with_continuous(
    choice: CatalogueChoice, continuous: PreloadSolution
) -> CatalogueChoice:
    """Compare with the optimum preloads of the same bolts at arbitrary torques."""
    if not continuous.status.usable:
        return replace(choice, continuous=continuous)
    assert choice.problem is not None
    worse = choice.objective - continuous.objective
    if choice.problem.objective == "joint_stiffness":
        worse = -worse
    gap = worse / continuous.objective
    if choice.proof.complete:
        gain = "Arbitrary instead of standard torques would gain"
    else:
        gain = "With the same bolts and arbitrary torques the design would be better by"
    text = f"{choice.message} {gain} {100 * max(gap, 0.0):.2f} %."
    return replace(choice, continuous=continuous, gap=gap, message=text)


@dataclass(frozen=True, kw_only=True)
class TighteningWay:
    """Optimum for one method and coating; lowest and highest friction [-], cost in steps."""

    method: str
    coating: str  # "" without a choice of coatings
    friction: float
    friction_highest: float | None
    status: SolveStatus
    objective: float
    cost: float = float("nan")

    @classmethod
    def of(cls, way: Tightening, coating: str, choice: CatalogueChoice) -> TighteningWay:
        """Return the optimum of a study that is tightened in this way."""
        return cls(
            method=way.method,
            coating=coating,
            friction=way.thread_friction,
            friction_highest=way.friction_highest,
            status=choice.status,
            objective=choice.objective,
            cost=choice.cost,
        )
