"""Optimum combination of catalogue designs by mixed-integer programming (HiGHS).

One binary variable per design, one design per element. The norm of a deflection vector is the
largest projection on any direction: directions in which a combination exceeds its linear rows are
added as cuts until both agree. No cut removes a feasible combination.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from stiffopt.preload.catalogue_designs import CatalogueDesign
from stiffopt.preload.catalogue_programme import ChoiceProgramme
from stiffopt.preload.solution import PreloadSolution

# Time limit for all goals of a study [s]; open combinations are reported.
MAX_SEARCH_SECONDS = 30.0
# HiGHS has absolute tolerances of 1e-6 on rows and gap: numbers of this size make them 1e-10
# relative.
_SOLVER_SCALE = 1e4
# Relative tolerance of optimality and of equal values: ten times the resolution of the programme.
_RELATIVE_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Goal:
    """Goal of a search: a sum over the elements, or the largest weighted row value."""

    cost: Sequence[np.ndarray] | None = None  # (m,) cost of each element's designs
    weight: np.ndarray | None = None  # (rows,) weights of the rows

    def value(self, programme: ChoiceProgramme, picks: Sequence[int]) -> float:
        """Return the goal's value for a combination."""
        if self.cost is not None:
            return float(sum(c[i] for c, i in zip(self.cost, picks, strict=True)))
        assert self.weight is not None
        return float((programme.amounts(picks) * self.weight).max())


@dataclass(frozen=True, eq=False)
class CombinationResult:
    """Result of one search."""

    picks: tuple[int, ...] | None  # position of each element's design; None if none was found
    value: float  # of the goal
    bound: float  # lower bound by the solver; infinite if infeasible
    evaluated: set[tuple[int, ...]]  # combinations whose goal and rows were evaluated
    nodes: int  # of the branch-and-bound trees
    complete: bool  # the search ended before the time limit

    @property
    def gap(self) -> float:
        """Relative distance of value and bound."""
        if self.picks is None:
            return math.inf
        return max(self.value - self.bound, 0.0) / max(abs(self.value), 1e-300)


@dataclass
class _Constraints:
    """Linear rows A x + level column <= upper, in the solver's scale."""

    matrix: list[np.ndarray] = field(default_factory=list)
    level: list[float] = field(default_factory=list)
    upper: list[float] = field(default_factory=list)

    def add(self, coefficients: np.ndarray, upper: float, level: float = 0.0) -> None:
        largest = max(abs(upper), float(np.abs(coefficients).max()), abs(level))
        size = _SOLVER_SCALE / (largest or 1.0)
        self.matrix.append(coefficients * size)
        self.level.append(level * size)
        self.upper.append(upper * size)


@dataclass(frozen=True)
class _ProgrammeResult:
    """Result of one mixed-integer programme."""

    picks: tuple[int, ...] | None
    bound: float
    nodes: int
    infeasible: bool


class CombinationSearch:
    """Lexicographic minimisation: each goal keeps the values of the former ones.

    `seconds`: time limit for all goals together.
    """

    def __init__(self, programme: ChoiceProgramme, seconds: float = MAX_SEARCH_SECONDS) -> None:
        self.programme = programme
        self._block_sizes = [len(c) for c in programme.cost]
        self._block_ends = np.cumsum(self._block_sizes)
        self._deadline = time.monotonic() + seconds
        self._reached_goals: list[tuple[Goal, float]] = []
        # Cut directions of each vector (k lists of unit vectors).
        self._directions = [[u] for u in programme.middle_directions()]
        self._excluded_combinations: list[np.ndarray] = []

    def minimise(self, goal: Goal) -> CombinationResult:
        """Find the best combination that satisfies all rows and the former goals."""
        best, best_value, bound = None, math.inf, -math.inf
        evaluated: set[tuple[int, ...]] = set()
        nodes, complete = 0, False
        while not complete:
            result = self._solve_programme(goal)
            nodes += result.nodes
            bound = max(bound, result.bound)
            if result.picks is not None:
                evaluated.add(result.picks)
                value = goal.value(self.programme, result.picks)
                if value < best_value and self._is_feasible(result.picks):
                    best, best_value = result.picks, value
            complete = (
                bound >= best_value - _RELATIVE_TOLERANCE * abs(best_value) or result.infeasible
            )
            if result.picks is None or time.monotonic() > self._deadline:
                break
            if not complete and not self._add_cuts(result.picks):
                self._excluded_combinations.append(self._mark_designs(result.picks))
        if best is not None:
            self._reached_goals.append((goal, best_value))
        if complete:
            bound = best_value
        return CombinationResult(best, best_value, bound, evaluated, nodes, complete)

    def conflicting_rows(self) -> tuple[str, ...]:
        """Return the rows exceeded by the combination of least excess, the largest first."""
        programme, picks = self.programme, None
        while True:
            result = self._solve_programme(None)
            # The solver may fail on nearly parallel rows; the former combination exceeds rows as
            # well.
            picks = picks if result.picks is None else result.picks
            if result.picks is None or not self._add_cuts(result.picks):
                break
            if time.monotonic() > self._deadline:
                break
        if picks is None:
            return ()
        excess = programme.amounts(picks) / programme.ends
        order = np.argsort(-excess)
        return tuple(programme.names[i] for i in order if excess[i] > 1.0)

    # ---- the programme

    def _solve_programme(self, goal: Goal | None) -> _ProgrammeResult:
        """Solve the programme with the present cuts; without a goal for the least excess."""
        from scipy.optimize import Bounds, LinearConstraint, milp

        count = int(self._block_ends[-1])
        rows = _Constraints()
        for coefficients, base, row in self._row_expressions():
            cap = float(self.programme.cap[row])
            if np.isfinite(cap):
                rows.add(coefficients, cap - base, level=0.0 if goal else -cap)
        for kept, value in self._reached_goals:
            self._bound_goal(rows, kept, value * (1.0 + _RELATIVE_TOLERANCE))
        for marks in self._excluded_combinations:
            rows.add(marks, len(self._block_sizes) - 1.0)
        cost, unit = self._goal_costs(rows, goal)
        seconds = max(self._deadline - time.monotonic(), 0.0)
        result = milp(
            cost,
            integrality=np.append(np.ones(count), 0),
            bounds=Bounds(0.0, np.append(np.ones(count), np.inf)),
            constraints=[
                LinearConstraint(self._one_design_rows(), 1.0, 1.0),
                *(
                    [
                        LinearConstraint(
                            np.column_stack([rows.matrix, rows.level]), -np.inf, rows.upper
                        )
                    ]
                    if rows.upper
                    else []
                ),
            ],
            options={"mip_rel_gap": 0.0, "time_limit": seconds},
        )
        dual = result.get("mip_dual_bound")
        return _ProgrammeResult(
            picks=None if result.x is None else self._read_picks(result.x),
            bound=-math.inf if dual is None else float(dual) / unit,
            nodes=int(result.get("mip_node_count") or 0),
            infeasible=result.status == 2,
        )

    def _goal_costs(self, rows: _Constraints, goal: Goal | None) -> tuple[np.ndarray, float]:
        """Return costs of designs and level, and the solver's scale of the goal."""
        count = int(self._block_ends[-1])
        if goal is None:
            return np.append(np.zeros(count), _SOLVER_SCALE), _SOLVER_SCALE
        if goal.cost is not None:
            cost = np.concatenate(goal.cost)
            least = sum(float(np.abs(c).min()) for c in goal.cost)
            unit = _SOLVER_SCALE / (least or float(np.abs(cost).max()) or 1.0)
            return np.append(cost * unit, 0.0), unit
        assert goal.weight is not None
        least = float((self.programme.least_amounts() * goal.weight).max())
        scale = least if least > 0.0 else 1.0
        self._bound_goal(rows, goal, 0.0, level=-scale)
        return np.append(np.zeros(count), _SOLVER_SCALE), _SOLVER_SCALE / scale

    def _bound_goal(self, rows: _Constraints, goal: Goal, value: float, level: float = 0.0) -> None:
        """Add rows that bound a goal by a value plus `level` times the level variable."""
        if goal.cost is not None:
            rows.add(np.concatenate(goal.cost), value)
            return
        assert goal.weight is not None
        for coefficients, base, row in self._row_expressions():
            weight = float(goal.weight[row])
            if weight > 0.0:
                rows.add(weight * coefficients, value - weight * base, level)

    def _row_expressions(self) -> list[tuple[np.ndarray, float, int]]:
        """Return coefficients, constant and row of every linear lower bound of a row value."""
        programme = self.programme
        linear = np.concatenate(programme.use)
        found = [(linear[:, r], float(programme.base[r]), r) for r in range(linear.shape[1])]
        vectors = np.concatenate(programme.vectors)
        for k, directions in enumerate(self._directions):
            found += [
                (vectors[:, k] @ u, float(programme.rest[k] @ u), linear.shape[1] + k)
                for u in directions
            ]
        return found

    def _one_design_rows(self) -> np.ndarray:
        """Return the rows of one design per element (elements, designs + 1)."""
        own = np.repeat(np.eye(len(self._block_sizes)), self._block_sizes, axis=1)
        return np.column_stack([own, np.zeros(len(self._block_sizes))])

    def _read_picks(self, x: np.ndarray) -> tuple[int, ...]:
        return tuple(int(np.argmax(own)) for own in np.split(x[:-1], self._block_ends[:-1]))

    def _mark_designs(self, picks: Sequence[int]) -> np.ndarray:
        """Return a vector with ones at the designs of a combination."""
        marks = np.zeros(int(self._block_ends[-1]))
        marks[self._block_ends - self._block_sizes + np.array(picks)] = 1.0
        return marks

    def _is_feasible(self, picks: Sequence[int]) -> bool:
        """Return True if a combination satisfies all rows and the former goals."""
        if (self.programme.amounts(picks) > self.programme.ends).any():
            return False
        return all(
            goal.value(self.programme, picks) <= value + 2.0 * _RELATIVE_TOLERANCE * abs(value)
            for goal, value in self._reached_goals
        )

    def _add_cuts(self, picks: Sequence[int]) -> bool:
        """Add this combination's vectors as cut directions; return True if any is new."""
        new = False
        for vector, directions in zip(
            self.programme.deflections(picks), self._directions, strict=True
        ):
            size = float(np.linalg.norm(vector))
            if size - max(float(u @ vector) for u in directions) > 0.1 * _RELATIVE_TOLERANCE * size:
                directions.append(vector / size)
                new = True
        return new


@dataclass(frozen=True, kw_only=True)
class SearchProof:
    """Account of a finished search; every combination is counted exactly once."""

    combinations: int  # number of combinations of all elements' designs
    # Combinations excluded without evaluation, by limit or rule; the first applicable one counts.
    excluded: Mapping[str, int]
    evaluated: int  # combinations whose objective and rows were evaluated
    unvisited: int  # combinations left open by the time limit; 0 for a proof
    nodes: int  # nodes of the branch-and-bound tree
    # Lower bound of the minimised quantity: total preload [N], largest utilisation [-], largest
    # deflection [m], largest weight over stiffness [-].
    bound: float
    gap: float  # relative distance of the best combination from the bound; infinite without one

    @property
    def complete(self) -> bool:
        """True if no combination is left open."""
        return self.unvisited == 0


def describe_proof(
    proof: SearchProof, chosen: Sequence[CatalogueDesign], solution: PreloadSolution
) -> str:
    """Return a message about the design and the search."""
    bolts = "; ".join(f"{d.key}: {d.label}" for d in chosen)
    if not proof.complete:
        return (
            f"Best design found: {bolts}. It satisfies every limit, but the search ended with "
            f"{proof.unvisited:,} of {proof.combinations:,} combinations undecided; their "
            f"lower bound of the minimised quantity is {proof.bound:.6g}."
        )
    out = sum(proof.excluded.values())
    text = (
        f"Best design of the catalogue: {bolts}. Of {proof.combinations:,} combinations {out:,} "
        f"were excluded by limits and bounds and {proof.evaluated:,} evaluated; none is better."
    )
    return text if solution.status.usable else f"{text} {solution.message}"
