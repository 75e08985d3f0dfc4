"""Solve a trajectory problem: baselines, staged collocation, certificate, refinement.

The optimiser sees the smoothed model at nodes and midpoints; the certificate evaluates the motion
with the exact model on a fine grid. Where a limit is exceeded, the solve is refined
(`solver.refinement`), or ends as `certificate_failed`. The optimiser's prediction of its motion is
compared with the exact model before the motion is called optimal.
"""

from __future__ import annotations

import functools
import time
from dataclasses import replace

import numpy as np

from stiffopt.baseline.baselines import baselines, better_baseline, strict_baseline
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.objective_value import improvement, objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE, describe_slips, find_slips
from stiffopt.command import simulated_solution
from stiffopt.command.command_search import CommandChoice
from stiffopt.command.simulation import check_simulation
from stiffopt.elastic.arm import questionable_springs
from stiffopt.errors import NoSolutionFound, ProblemError
from stiffopt.interrupts import end_deferral, until_interrupted
from stiffopt.path.path_duty import describe_duty
from stiffopt.path.timed_path import FASTEST_REASON
from stiffopt.problem.bounds import check_bounds, shortest_duration
from stiffopt.problem.files import LoadedProblem
from stiffopt.problem.input_checks import (
    check_clear_poses,
    inconsistent_inertias,
    shifted_numbers,
    slack_belts,
)
from stiffopt.problem.limits.travel import with_bounded_travel
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.provenance import inputs_hash, versions
from stiffopt.result.solution import Baseline, Solution
from stiffopt.result.status import ProgressCallback, SolveStatus
from stiffopt.solver.between_rivals import BetweenRivals, search_rivals
from stiffopt.solver.collision_avoidance import avoid_collisions
from stiffopt.solver.exchange import exchange, interrupted_outcome
from stiffopt.solver.initial_guess import guess_from_motion, initial_guess, perturb_guess
from stiffopt.solver.input_shaping import Window, mark_solution_interrupted, solve_shaped
from stiffopt.solver.path_command import led_timing
from stiffopt.solver.programme import Outcome
from stiffopt.solver.robust_plan import choose_shaped_motion, robust_plan
from stiffopt.solver.slowing import Slowing
from stiffopt.solver.solve_run import MIN_SOLVE_TIME, SolveRun
from stiffopt.solver.starts import BetterBaseline, best_of_starts
from stiffopt.solver.trivial_outcomes import (
    baseline_as_optimum,
    baseline_at_bound,
    below_base_warning,
    explain_bound,
    feasible_duration_advice,
    infeasible_solution,
    interrupted_with_baseline,
    solver_record,
)
from stiffopt.solver.verdict import describe_optimality, judge_collisions, judge_outcome
from stiffopt.transcription.ocp import Guess

# Statuses for which the duration may be too short for any motion.
_POSSIBLY_TOO_FAST = (
    SolveStatus.CERTIFICATE_FAILED,
    SolveStatus.INFEASIBLE,
    SolveStatus.ITERATION_LIMIT,
)
# Objective over its sufficient value, up to which it counts as lowered to that.
_SUFFICIENT_OBJECTIVE_FACTOR = 1.1


def solve(
    problem: TrajectoryProblem | LoadedProblem,
    *,
    progress: ProgressCallback | None = None,
    guess: Guess | Assessment | None = None,
    throw: bool = True,
    simulate: bool = False,
    start: int = 0,
) -> Solution:
    """Optimise a motion and certify it.

    Parameters
    ----------
    problem : TrajectoryProblem or LoadedProblem
        The latter as returned by `load_problem`.
    progress : callable, optional
        Called with a `SolveProgress` in every iteration.
    guess : Guess or Assessment, optional
        Initial guess, such as `guess` of an earlier solution; toppra's motion if left out.
    throw : bool
        Raise `NoSolutionFound` unless the status is optimal, acceptable or interrupted.
    simulate : bool
        Simulate the motion and its baselines on the elastic arm: `Solution.simulation`.
    start : int
        Above zero: start from a random smooth detour of the guess, another for each number.

    Returns
    -------
    Solution

    Raises
    ------
    ProblemError
        The problem is infeasible or its objective degenerate, found before solving.
    NoSolutionFound
        With the solution so far, where `throw` is set.
    """
    if isinstance(problem, LoadedProblem):
        problem = problem.problem
    solution, _ = solve_with_state(
        problem, progress=progress, guess=guess, simulate=simulate, start=start
    )
    if throw and not (solution.status.usable or solution.status is SolveStatus.INTERRUPTED):
        raise NoSolutionFound(solution.message, solution)
    return solution


def solve_with_state(
    problem: TrajectoryProblem,
    *,
    progress: ProgressCallback | None = None,
    guess: Guess | Assessment | None = None,
    simulate: bool = False,
    start: int = 0,
    compare: bool = True,
    beside_rivals: bool = True,
) -> tuple[Solution, tuple[SolveRun, Outcome] | None]:
    """Solve a problem and return its solver state too, None where there was no programme.

    `compare`: also search the baseline that keeps every limit. `beside_rivals`: simulate rivals
    too.
    """
    stated, motion = problem, resolve(problem)
    problem = with_bounded_travel(stated, motion)
    # Reports unreadable meshes of the cell before the solve.
    _ = problem.clearance_model
    check_clear_poses(problem, motion)
    if simulate:
        check_simulation(problem, motion)
    notes = preliminary_notes(problem, motion, simulate=simulate)
    compared = baselines(problem, motion)
    run = SolveRun(
        problem, motion, _objective_scales(problem, compared), progress, compared.get("quintic")
    )
    needed, why = shortest_duration(problem, motion)
    if problem.duration[1] < needed:
        solution = infeasible_solution(run, compared, notes, why)
    elif problem.is_shaped:
        inner = functools.partial(solve, progress=progress, guess=guess, throw=False)
        solution = solve_shaped(run, compared, notes, inner)
    elif (pinned := baseline_at_bound(run, compared)) is not None and not start:
        solution = baseline_as_optimum(run, compared, notes, pinned[0], explain_bound(pinned[1]))
    elif problem.is_timed_on_path and (timed := _timed_motion(run)) is not None:
        solution = baseline_as_optimum(run, compared, notes, timed, FASTEST_REASON)
        solution = mark_solution_interrupted(solution) if run.interrupted else solution
    else:
        solution = until_interrupted(
            lambda: _optimise(run, compared, notes, guess, start=start, compare=compare),
            lambda: interrupted_solution(run, compared, notes),
        )
    solution = complete_solution(
        stated, run, solution, simulate=simulate, beside_rivals=beside_rivals
    )
    return solution, None if run.optimum is None else (run, run.optimum)


def complete_solution(
    stated: TrajectoryProblem,
    run: SolveRun,
    solution: Solution,
    *,
    simulate: bool,
    beside_rivals: bool,
    choice: CommandChoice | None = None,
) -> Solution:
    """Return the solution of the problem as stated, whose travel `run` has bounded.

    With the steps that the time limit ended; `simulate`, `beside_rivals` and `choice` as of
    `with_simulation`.
    """
    solution = _name_steps_left_out(run, solution)
    if simulate:
        solution = simulated_solution.with_simulation(
            stated,
            solution,
            run.progress,
            run.motion,
            run.command,
            run.rivals,
            run.motors if stated.plans_links else None,
            choice=choice,
            compare=beside_rivals,
        )
    return replace(solution, inputs_hash=inputs_hash(stated))


def _optimise(
    run: SolveRun,
    compared: dict[str, Baseline],
    notes: tuple[str, ...],
    guess: Guess | Assessment | None,
    *,
    start: int,
    compare: bool,
) -> Solution:
    """Return the best motion of all starts, clear of collisions and chosen for uncertain arms."""
    problem = run.problem
    end_deferral()
    begin = _select_guess(problem, run.motion, compared, guess)
    if start:
        begin = perturb_guess(begin, problem, np.random.default_rng([problem.method.seed, start]))
    outcome = best_of_starts(run, begin)
    rivals = _all_rivals(compared, _strict_baseline_of(run, compared) if compare else None)
    outcome = exchange(run, BetterBaseline(run, rivals), outcome)
    search_rivals(run, outcome)
    outcome = run.optimum = exchange(run, BetweenRivals(run, outcome), outcome)
    if problem.avoids_collisions:
        outcome = avoid_collisions(run, outcome, searches=problem.method.starts)
        # Clearance rows hold for this motion only: no warm start from there.
        run.optimum = None if run.avoidance else outcome
        compared |= {} if run.detour is None else {run.detour.name: run.detour}
    return choose_for_arms(run, outcome, compared, notes, guess, compare=compare)


def choose_for_arms(
    run: SolveRun,
    outcome: Outcome,
    compared: dict[str, Baseline],
    notes: tuple[str, ...],
    guess: Guess | Assessment | None = None,
    *,
    compare: bool,
) -> Solution:
    """Return the solution of an optimum, or of a motion near it for uncertain arms."""
    robust = robust_plan(run, outcome)
    robust = exchange(run, Slowing(run), robust)
    run.solution = solution_of(run, robust, compared, notes, compare=compare)
    shaped = functools.partial(_solve_shaped_in_remaining_time, run, compared, notes, guess)
    return choose_shaped_motion(run, run.solution, outcome, shaped)


def interrupted_solution(
    run: SolveRun, compared: dict[str, Baseline], notes: tuple[str, ...]
) -> Solution:
    """Return the best motion so far after Ctrl-C, a baseline where there is none."""
    if run.solution is not None:
        return mark_solution_interrupted(run.solution)
    if run.best is None and run.unfinished is None:
        return interrupted_with_baseline(run, compared, notes)
    return solution_of(run, interrupted_outcome(run), compared, notes, compare=False)


def _timed_motion(run: SolveRun) -> Baseline | None:
    """Return the fastest motion on the path; its time counts as that of the solve."""
    begin = time.perf_counter()
    found = led_timing(run)
    if found is not None and found.assessment is not None:
        run.notes.append(describe_duty(run.problem.robot, found.assessment))
    run.solve_s += time.perf_counter() - begin
    return found


def _name_steps_left_out(run: SolveRun, solution: Solution) -> Solution:
    """Return the solution with the steps that the time limit ended; it is not optimal then."""
    usable = solution.status.usable
    if not run.left_out or not (usable or solution.status is SolveStatus.CERTIFICATE_FAILED):
        return solution
    return replace(
        solution,
        status=SolveStatus.ACCEPTABLE if usable else solution.status,
        message=(
            f"{solution.message} But the time limit ended or left out: {', '.join(run.left_out)};"
            f" raise method.time_limit above {run.problem.method.time_limit:g} s."
        ),
        solver=replace(solution.solver, left_out=tuple(run.left_out)),
    )


def _solve_shaped_in_remaining_time(
    run: SolveRun,
    compared: dict[str, Baseline],
    notes: tuple[str, ...],
    guess: Guess | Assessment | None,
    windows: tuple[Window, ...],
) -> Solution:
    """Solve the problem with input shaping over windows, in the remaining time."""
    left = max(run.problem.method.time_limit - run.elapsed, MIN_SOLVE_TIME)
    shaped = tuple(replace(each, name="shaped_deviation") for each in run.problem.objectives)
    method = replace(run.problem.method, time_limit=left)
    problem = replace(run.problem, objectives=shaped, method=method)
    inner = functools.partial(solve, progress=run.progress, guess=guess, throw=False)
    shaped_run = SolveRun(problem, run.motion, run.scales, run.progress)
    return solve_shaped(shaped_run, compared, notes, inner, windows)


def _select_guess(
    problem: TrajectoryProblem,
    motion: ResolvedMotion,
    compared: dict[str, Baseline],
    guess: Guess | Assessment | None,
) -> Guess:
    """Return the given guess, or one from an earlier motion or a baseline."""
    if guess is None:
        return initial_guess(problem, motion, compared)
    if isinstance(guess, Guess):
        return guess
    if guess.position.shape[1] != problem.joints:
        raise ProblemError(
            f"the guess has {guess.position.shape[1]} joints, {problem.robot.name} has"
            f" {problem.joints}. Use one of the same arm."
        )
    return guess_from_motion(problem, motion, guess)


def preliminary_notes(
    problem: TrajectoryProblem, motion: ResolvedMotion, *, simulate: bool
) -> tuple[str, ...]:
    """Return notes on a problem before it is solved; raise `ProblemError` if it is degenerate."""
    chosen = (problem.chosen,) if problem.chosen else ()
    # Uses the tables of the simulation.
    soft = questionable_springs(problem.robot, motion.start) if simulate else ""
    doubted = (
        *shifted_numbers(problem.robot),
        *inconsistent_inertias(problem.robot),
        *slack_belts(problem.robot),
    )
    return (
        *chosen,
        *problem.remarks,
        *doubted,
        *_describe_held_joints(problem),
        *check_bounds(problem, motion),
        *([soft] if soft else []),
    )


def _describe_held_joints(problem: TrajectoryProblem) -> tuple[str, ...]:
    """Return a note on joints of the URDF that are held without having been locked by the file."""
    held = [str(each) for each in problem.robot.held if each.why != "locked"]
    return (f"Held, not planned: {'; '.join(held)}.",) if held else ()


def _objective_scales(problem: TrajectoryProblem, compared: dict[str, Baseline]) -> Scales:
    """Return typical values of the objectives, from baselines."""
    motions = [each.assessment for each in compared.values() if each.assessment is not None]
    values: dict[str, float] = {}
    for objective in problem.objectives if motions else ():
        values |= objective.kind.scales(objective, motions)
    return Scales(values)


def solution_of(
    run: SolveRun,
    outcome: Outcome,
    compared: dict[str, Baseline],
    notes: tuple[str, ...],
    *,
    compare: bool = True,
) -> Solution:
    """Return the solution of an outcome; `compare` searches the baseline that keeps every limit."""
    problem, assessment = run.problem, with_collisions(run.problem, outcome.assessment)
    strict = None
    if outcome.raw.status != "infeasible":
        strict = _strict_baseline_of(run, compared) if compare else run.strict
    rivals = _all_rivals(compared, strict)
    found = judge_outcome(problem, outcome, assessment, rivals, run.exchanges)
    if found.status is SolveStatus.OPTIMAL:
        reach = describe_optimality(problem, rivals, run.starts_made)
        found = replace(found, message=f"{found.message} {reach}")
    end = judge_collisions(problem, assessment, found, run.avoidance_failure)
    slipping = find_slips(problem.robot, assessment)
    if slipping and describe_slips(slipping) not in end.message:
        notes = (*notes, f"In this motion {describe_slips(slipping)}")
    if (
        not slipping
        and end.status in _POSSIBLY_TOO_FAST
        and not assessment.feasible(CERTIFICATE_TOLERANCE)
    ):
        advice = feasible_duration_advice(run, outcome)
        end = replace(end, message=f"{end.message} {advice}".rstrip())
    value = objective_value(problem, assessment)
    solution = Solution(
        status=end.status,
        message=end.message,
        trajectory=outcome.trajectory,
        assessment=assessment,
        objective=value,
        baselines={},
        ratio_to_better_baseline=None,
        solver=solver_record(run, len(outcome.transcription.intervals)),
        notes=(
            *notes,
            *run.notes,
            *_describe_sufficient_objective(run, value.value),
            *below_base_warning(problem, assessment),
        ),
        inputs_hash=inputs_hash(problem),
        versions=versions(),
    )
    return _beside_baselines(problem, solution, compared, strict)


def _beside_baselines(
    problem: TrajectoryProblem,
    solution: Solution,
    compared: dict[str, Baseline],
    strict: Baseline | None,
) -> Solution:
    """Return a solution with its baselines, and their ratios where there is a motion."""
    infeasible = solution.status is SolveStatus.INFEASIBLE

    def ratio_to(rival: Baseline | None) -> float | None:
        if infeasible or rival is None or rival.objective is None or solution.objective is None:
            return None
        return improvement(problem, solution.objective.value, rival.objective)

    return replace(
        solution,
        baselines=compared,
        ratio_to_better_baseline=ratio_to(better_baseline(problem, compared)),
        strict_baseline=None if infeasible else strict,
        ratio_to_strict_baseline=ratio_to(strict),
    )


def complete_comparison(problem: TrajectoryProblem, solution: Solution) -> Solution:
    """Return a stored solution beside baselines and simulated rivals, where it has none."""
    motion = resolve(problem)
    bounded = with_bounded_travel(problem, motion)
    if not solution.baselines and solution.objective is not None:
        compared = baselines(bounded, motion)
        strict = strict_baseline(bounded, motion, compared)
        solution = _beside_baselines(bounded, solution, compared, strict)
    return simulated_solution.beside_rivals(problem, motion, solution)


def _describe_sufficient_objective(run: SolveRun, value: float) -> list[str]:
    """Return a note where the objective was lowered to its sufficient value only."""
    kind = run.problem.objectives[0].kind
    enough = kind.target_value(run.scales.of(kind.name))
    if len(run.problem.objectives) > 1 or not 0.0 < value <= _SUFFICIENT_OBJECTIVE_FACTOR * enough:
        return []
    return [
        f"The {kind.phrase} was lowered to {1e3 * enough:.2g} mm and no further: no arm repeats "
        "its path better, and less takes detours of the wrist."
    ]


def _strict_baseline_of(run: SolveRun, compared: dict[str, Baseline]) -> Baseline | None:
    """Return the baseline that keeps every limit, searched once."""
    if run.strict is None:
        run.strict = strict_baseline(run.problem, run.motion, compared)
    return run.strict


def _all_rivals(compared: dict[str, Baseline], strict: Baseline | None) -> dict[str, Baseline]:
    """Return all motions that may be better than the optimised one."""
    return compared if strict is None else compared | {strict.name: strict}
