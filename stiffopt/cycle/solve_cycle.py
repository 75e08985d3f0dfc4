"""Solve a cycle: every leg, and the split of the cycle's time between the legs.

Where the time of the cycle is minimised under limits, its optimum is that of every leg. Where it is
given, the split of least objective is found by `TimeSplit`; limits of the duty by `DutyWeights`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from stiffopt.baseline.rivals import fair_rivals
from stiffopt.certificate.objective_value import objective_value
from stiffopt.command.simulated_solution import with_simulation
from stiffopt.cycle.cycle_simulation import cycle_duty, simulate_cycle
from stiffopt.cycle.duty_weights import DutyWeights
from stiffopt.cycle.time_split import Combination, ShortestDuration, TimeSplit, combined
from stiffopt.errors import NotSimulatedError
from stiffopt.problem.bounds import shortest_duration
from stiffopt.problem.branches import quintic_durations
from stiffopt.problem.cycle import MIN_LEG_TIME, Cycle, Leg
from stiffopt.problem.objective import Objective
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import Target, TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.cycle import CycleSolution, LegResult, RivalCycle
from stiffopt.result.duty import DutyUse
from stiffopt.result.solution import ObjectiveValue, Solution
from stiffopt.result.status import ProgressCallback, SolveProgress, SolveStatus
from stiffopt.solver.solve import solve

# Rounds of the split; each solves every leg whose duration changed.
_MAX_ROUNDS = 8
# Relative change of the cycle's objective at which the split has converged.
_CONVERGED_CHANGE = 2e-3
# First duration of a leg under an error limit, over the bound by its joints' limits.
_FIRST_DURATION_FACTOR = 1.5
# Rounds in which rests until the tool has settled are found by simulation, and their change at
# which they are kept [s].
_MAX_REST_ROUNDS, _SAME_REST = 4, 2e-3
# Solves of a cycle until the limits of its duty are just kept.
_MAX_DUTY_ROUNDS = 10
# Loss of the objective by limits of the duty below which their weights are not searched further.
_FREE_DUTY_LOSS = 5e-4
# Statuses from best to worst; the cycle has the worst of its legs.
_STATUS_RANKS = (
    SolveStatus.OPTIMAL,
    SolveStatus.ACCEPTABLE,
    SolveStatus.TIME_LIMIT,
    SolveStatus.ITERATION_LIMIT,
    SolveStatus.INTERRUPTED,
    SolveStatus.CERTIFICATE_FAILED,
    SolveStatus.INFEASIBLE,
)


def solve_cycle(
    cycle: Cycle,
    *,
    progress: ProgressCallback | None = None,
    simulate: bool = True,
    guesses: Sequence[Assessment] = (),
) -> CycleSolution:
    """Optimise and certify a cycle.

    `progress`: as of `solve`. `simulate`: simulate the cycle on the elastic arm, with the command
    of each leg. Rests until the tool has settled are zero without. `guesses`: motion of each leg to
    start from, and their durations; none for a start of its own.
    """
    run = _CycleRun(cycle, progress, guesses)
    rests = np.array([leg.stop.dwell for leg in cycle.legs])
    for _ in range(_MAX_REST_ROUNDS if simulate else 1):
        solutions = run.solve_within_duty(rests)
        found = run.result(solutions, rests)
        usable = all(each.status.usable for each in solutions) and len(solutions) == len(cycle.legs)
        if not usable:
            return found
        if not simulate:
            return run.with_verdict(found)
        solutions = run.with_commands(solutions)
        try:
            simulation, settled = simulate_cycle(cycle, solutions, rests)
        except NotSimulatedError as error:
            found = replace(found, notes=(*found.notes, f"Not simulated as a cycle: {error}"))
            break
        found = replace(run.result(solutions, settled), simulation=simulation)
        changed = float(np.max(np.abs(settled - rests)))
        rests = settled
        if changed <= _SAME_REST or cycle.time_is_minimised:
            break
    return run.with_rivals(run.with_verdict(found))


class _CycleRun:
    """Solve of one cycle, with what is known of its legs."""

    def __init__(
        self, cycle: Cycle, progress: ProgressCallback | None, guesses: Sequence[Assessment]
    ) -> None:
        self._cycle, self._progress = cycle, progress
        self._guesses = guesses
        self._solved: dict[int, tuple[float, Solution]] = {}
        self._splits: list[tuple[float, ...]] = []
        self._durations = np.array([each.duration for each in guesses]) if guesses else None
        self._infeasible = ""
        self._duty_terms: tuple[Objective, ...] = ()

    def solve_within_duty(self, rests: np.ndarray) -> list[Solution]:
        """Solutions of all legs that keep the limits of the duty, where the objective is a sum."""
        cycle, limits = self._cycle, self._cycle.duty_limits
        sums = cycle.error_limit is None and (cycle.time_is_minimised or self._combination == "sum")
        solutions, count = self.solve_legs(float(rests.sum())), len(cycle.legs)
        weights: DutyWeights | None = None
        best, kept = np.inf, dict(self._solved)
        for _ in range(_MAX_DUTY_ROUNDS if sums else 0):
            if len(solutions) < count or not all(each.status.usable for each in solutions):
                break
            found = self.result(solutions, rests)
            assert found.objective is not None
            value, uses = found.objective.value, limits.uses(cycle_duty(cycle, found))
            weights = weights or DutyWeights(scale=abs(value))
            if value < best and all(use.share <= 1.0 for use in uses):
                best, kept = value, dict(self._solved)
            if weights.kept(uses) or best <= (1.0 + _FREE_DUTY_LOSS) * weights.scale:
                break
            weights.learn(uses, _duty_integrals(uses, solutions))
            self._duty_terms = weights.objectives()
            self._guesses = [s.assessment for s in solutions if s.assessment is not None]
            self._solved = {}
            solutions = self.solve_legs(float(rests.sum()))
        if len(kept) < count:
            return solutions
        self._solved = kept
        return [kept[k][1] for k in range(count)]

    def solve_legs(self, rest: float) -> list[Solution]:
        """Solutions of all legs, up to the first that failed where nothing can help it."""
        cycle = self._cycle
        if cycle.error_limit is not None:
            return self._shortest_legs(cycle.error_limit)
        if not cycle.times_legs:
            if len(self._solved) == len(cycle.legs):
                return [self._solved[k][1] for k in range(len(cycle.legs))]
            return self._solve_each(cycle.legs, stop_at_failure=True)
        total = cycle.duration[0] - rest
        first = self._durations
        if first is None:
            first = np.array([leg.problem.duration[0] for leg in cycle.legs])
        split = TimeSplit(total, first * total / first.sum(), self._combination)
        best: tuple[float, dict[int, tuple[float, Solution]]] | None = None
        solutions: list[Solution] = []
        for _ in range(_MAX_ROUNDS):
            legs = [
                leg.lasting(float(each))
                for leg, each in zip(cycle.legs, split.durations, strict=True)
            ]
            self._splits.append(tuple(split.durations.tolist()))
            solutions = self._solve_each(legs)
            if any(each.status is SolveStatus.INTERRUPTED for each in solutions):
                break
            values = np.array(
                [
                    each.objective.value
                    if each.status.usable and each.objective is not None
                    else np.nan
                    for each in solutions
                ]
            )
            value = combined(values, split.durations, self._combination)
            if np.isfinite(value):
                before = np.inf if best is None else best[0]
                if value < before:
                    best = (value, dict(self._solved))
                if abs(before - value) <= _CONVERGED_CHANGE * value:
                    break
            split.learn(values)
            proposed = split.proposal()
            if proposed is None:
                self._infeasible = (
                    f"the legs cannot be made in {total:.4g} s beside the rests; the last split "
                    f"was {', '.join(f'{each:.3g}' for each in split.durations)} s. Allow a longer "
                    "motion.duration."
                )
                break
            split.durations = proposed
        if best is None:
            return solutions
        self._solved = best[1]
        kept = [self._solved[k] for k in range(len(cycle.legs))]
        self._durations = np.array([duration for duration, _ in kept])
        return [solution for _, solution in kept]

    def _shortest_legs(self, limit: float) -> list[Solution]:
        """Solutions of all legs, each as short as an objective within `limit` allows."""
        found = []
        for k, leg in enumerate(self._cycle.legs):
            if k in self._solved:
                found.append(self._solved[k][1])
                continue
            least = shortest_duration(leg.problem, resolve(leg.problem))[0]
            search = ShortestDuration(limit, max(_FIRST_DURATION_FACTOR * least, MIN_LEG_TIME))
            guess, best = self._guess(k), None
            while (duration := search.proposal()) is not None:
                best = solve(
                    leg.lasting(duration).problem,
                    progress=self._leg_progress(k),
                    guess=guess,
                    throw=False,
                )
                if best.status is SolveStatus.INTERRUPTED:
                    return [*found, best]
                usable = best.status.usable and best.objective is not None
                value = best.objective.value if usable and best.objective else np.nan
                guess = best.assessment if usable else guess
                if search.learn(value):
                    self._solved[k] = (duration, best)
            if k not in self._solved:
                assert best is not None
                self._solved[k] = (search.duration, best)
                self._infeasible = (
                    f"no duration was found at which the leg keeps motion.error_limit of "
                    f"{1e3 * limit:.4g} mm; raise it."
                )
                return [*found, replace(best, status=SolveStatus.INFEASIBLE)]
            found.append(self._solved[k][1])
        return found

    @property
    def _combination(self) -> Combination:
        terms = self._cycle.first.objectives
        if all(each.kind.measured and each.measure == "peak" for each in terms):
            return "peak"
        if len(terms) == 1 and terms[0].kind.measured:
            return "rms"
        return "sum"

    def _solve_each(
        self, legs: tuple[Leg, ...] | list[Leg], stop_at_failure: bool = False
    ) -> list[Solution]:
        found: list[Solution] = []
        for k, leg in enumerate(legs):
            duration = leg.problem.duration[0]
            lasted, known = self._solved.get(k, (np.nan, None))
            if known is None or lasted != duration:
                guess = self._guess(k)
                if known is not None and known.status.usable and known.assessment is not None:
                    guess = known.assessment
                stated, terms = leg.problem, self._duty_terms
                asked = (
                    replace(stated, objectives=(*stated.objectives, *terms)) if terms else stated
                )
                known = solve(asked, progress=self._leg_progress(k), guess=guess, throw=False)
                if terms and known.assessment is not None:
                    known = replace(known, objective=objective_value(stated, known.assessment))
                self._solved[k] = (duration, known)
            found.append(known)
            if known.status is SolveStatus.INTERRUPTED:
                break
            if stop_at_failure and not known.status.usable:
                break
        return found

    def _guess(self, k: int) -> Assessment | None:
        return self._guesses[k] if self._guesses else None

    def _leg_progress(self, k: int) -> Callable[[SolveProgress], object] | None:
        if self._progress is None:
            return None
        return partial(_tell_leg, self._progress, f"leg {k + 1} of {len(self._cycle.legs)}")

    def with_commands(self, solutions: list[Solution]) -> list[Solution]:
        """Solutions with the simulation and the command of each leg."""
        found = []
        for k, each in enumerate(solutions):
            if each.simulation is None:
                each = with_simulation(self._solved_problem(k), each, self._leg_progress(k))
                self._solved[k] = (self._solved[k][0], each)
            found.append(each)
        return found

    def _solved_problem(self, k: int) -> TrajectoryProblem:
        """Problem of leg k (from 0) as it was solved."""
        leg = self._cycle.legs[k]
        timed = self._cycle.times_legs
        return leg.lasting(self._solved[k][0]).problem if timed else leg.problem

    def result(self, solutions: list[Solution], rests: np.ndarray) -> CycleSolution:
        """Result of the legs' solutions and the rests after them (L,) [s]."""
        cycle, legs, time = self._cycle, [], 0.0
        for k, (leg, solution, rest) in enumerate(zip(cycle.legs, solutions, rests, strict=False)):
            arrival = time + (solution.duration or 0.0)
            event = leg.stop.event
            mass = 0.0 if leg.problem.robot.payload is None else float(leg.problem.robot.payload[0])
            legs.append(
                LegResult(
                    name=leg.name,
                    moves=leg.moves,
                    solution=solution,
                    problem=self._solved_problem(k),
                    start=time,
                    arrival=arrival,
                    dwell=float(rest),
                    until_settled=leg.stop.until_settled,
                    event="" if event is None else event.kind,
                    mass_before=mass if event is None else event.mass_before,
                    mass_after=mass if event is None else event.mass_after,
                )
            )
            time = arrival + float(rest)
        status = max((each.status for each in solutions), key=_STATUS_RANKS.index)
        return CycleSolution(
            status=status,
            message=self._message(solutions, status),
            title=cycle.title,
            legs=tuple(legs),
            objective=self._objective(solutions, time),
            postures=cycle.postures,
            notes=tuple(dict.fromkeys(note for each in legs for note in _leg_notes(each))),
            splits=tuple(self._splits),
        )

    def _message(self, solutions: list[Solution], status: SolveStatus) -> str:
        count = len(self._cycle.legs)
        worst = next(k for k, each in enumerate(solutions) if each.status is status)
        leg = self._cycle.legs[worst]
        if status.usable and len(solutions) == count:
            told = "Every leg is solved and certified."
            if status is not SolveStatus.OPTIMAL:
                # How near it is to its optimum, and why.
                why = ". ".join(solutions[worst].message.split(". ")[:2])
                told += f" Leg {worst + 1} ({leg.name}): {why.rstrip('.')}."
            return told
        why = f" {self._infeasible[0].upper()}{self._infeasible[1:]}" if self._infeasible else ""
        return f"leg {worst + 1} ({leg.name}): {solutions[worst].message}{why}"

    def _objective(self, solutions: list[Solution], time: float) -> ObjectiveValue | None:
        if len(solutions) < len(self._cycle.legs) or any(s.objective is None for s in solutions):
            return None
        found = [s.objective for s in solutions if s.objective is not None]
        if self._cycle.time_is_minimised and len(self._cycle.first.objectives) == 1:
            return ObjectiveValue(name="duration", measure="", value=time, unit="s")
        lasted = np.array([s.duration for s in solutions])
        value = combined(np.array([each.value for each in found]), lasted, self._combination)
        return replace(found[0], value=value, terms={})

    def with_verdict(self, found: CycleSolution) -> CycleSolution:
        """Return the result with its duty, judged by the limits of that and of the cycle's time."""
        upper = self._cycle.duration[1]
        if found.duration > upper * (1.0 + 1e-9):
            found = replace(
                found,
                status=SolveStatus.INFEASIBLE,
                message=f"the shortest cycle takes {found.duration:.4g} s, above motion.duration "
                f"of {upper:.4g} s. Allow more time, or relax limits.",
            )
        duty = cycle_duty(self._cycle, found)
        over = [use.text for use in self._cycle.duty_limits.uses(duty) if use.share > 1.0]
        if over and found.status.usable:
            found = replace(
                found,
                status=SolveStatus.CERTIFICATE_FAILED,
                message=f"Every limit of the legs holds, but {'; '.join(over)}. Give longer dwells "
                "or more time.",
            )
        return replace(found, duty=duty)

    def with_rivals(self, found: CycleSolution) -> CycleSolution:
        """Result with cycles of baselines that stop at every pose and keep every limit.

        None beside an error limit. Where the time of the legs is given, each move has its share of
        that of its leg.
        """
        if self._cycle.error_limit is not None:
            return found
        times: dict[str, list[float]] = {}
        values: dict[str, list[float]] = {}
        moves = [each for leg in found.legs for each in _single_moves(leg)]
        for problem, share in moves:
            shortest = share if self._cycle.times_legs else problem.duration[0]
            for rival, motion in fair_rivals(problem, resolve(problem), shortest):
                times.setdefault(rival.name, []).append(motion.duration)
                values.setdefault(rival.name, []).append(objective_value(problem, motion).value)
        rest = sum(leg.dwell for leg in found.legs)
        rivals = tuple(
            RivalCycle(
                name=name,
                duration=sum(own) + rest,
                objective=sum(own) + rest
                if self._cycle.time_is_minimised
                else combined(np.array(values[name]), np.array(own), self._combination),
            )
            for name, own in times.items()
            if len(own) == len(moves)
        )
        return replace(found, rivals=rivals)


def _duty_integrals(
    uses: Sequence[DutyUse], solutions: Sequence[Solution]
) -> dict[tuple[str, int], float]:
    """Return the integrals over all legs that the limits of a duty bound."""
    found: dict[tuple[str, int], float] = {}
    for use in uses:
        term = Objective(name=use.objective, joints=(use.joint,) if use.joint else ())
        found[use.objective, use.joint] = sum(
            term.kind.certified_value(term, each.assessment)
            for each in solutions
            if each.assessment is not None
        )
    return found


def _single_moves(leg: LegResult) -> list[tuple[TrajectoryProblem, float]]:
    """Moves of a solved leg, each from rest to rest, with their shares of its time [s]."""
    problem = leg.problem
    points = resolve(problem).points
    limits = problem.active_limits
    rates = (limits.velocity, limits.acceleration, limits.jerk)
    pairs = list(itertools.pairwise(points))
    needed = np.array([quintic_durations(a[None], b[None], rates)[0, 0] for a, b in pairs])
    shares = (leg.arrival - leg.start) * needed / needed.sum()
    return [
        (replace(problem, start=Target(joints=a), end=Target(joints=b), vias=()), float(share))
        for (a, b), share in zip(pairs, shares, strict=True)
    ]


def _leg_notes(leg: LegResult) -> list[str]:
    """Return the notes of a leg, and why it has no command."""
    made = leg.solution.compensation
    missing = [f"{leg.name}: {made.refusal}"] if made is not None and made.refusal else []
    return [*leg.solution.notes, *missing]


def _tell_leg(progress: ProgressCallback, name: str, state: SolveProgress) -> object:
    return progress(replace(state, stage=f"{name}, {state.stage}"))
