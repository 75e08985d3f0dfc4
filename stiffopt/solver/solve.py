"""Solve a trajectory problem: baselines, staged collocation, certificate, refinement.

The optimiser sees the smoothed model at nodes and midpoints; the certificate judges the motion with
the exact model on a fine grid. Where it finds a limit exceeded, the solve is refined
(`solver.refinement`), or ends as `certificate_failed`. What the optimiser believed of its motion is
compared with the exact model before it is called optimal.
"""

from __future__ import annotations

import functools
from contextlib import suppress
from dataclasses import replace

import numpy as np

from stiffopt.baseline.baselines import baselines, better_baseline, strict_baseline
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.objective_value import (
    improvement,
    is_maximised,
    objective_value,
)
from stiffopt.certificate.slipping import slip_text, slips
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.elastic.arm import questionable_springs
from stiffopt.errors import NoSolutionFound, ProblemError
from stiffopt.interrupts import delivered
from stiffopt.problem.bounds import check_bounds, shortest_duration
from stiffopt.problem.files import LoadedProblem
from stiffopt.problem.formulation import Scales
from stiffopt.problem.input_checks import check_clear_poses, inconsistent_inertias, slack_belts
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.provenance import inputs_hash, versions
from stiffopt.result.solution import Baseline, Solution
from stiffopt.result.status import SolveStatus
from stiffopt.solver import frontal
from stiffopt.solver.guess import guess_along, initial_guess
from stiffopt.solver.plan import stages
from stiffopt.solver.refinement import rank, refined, stopped
from stiffopt.solver.robust_plan import robust_plan, shaped_for_arms
from stiffopt.solver.shaping import Window, solve_shaped
from stiffopt.solver.simulation import check_simulation, with_simulation
from stiffopt.solver.slower import slower_advice
from stiffopt.solver.solve_run import LEAST_TIME, ProgressCallback, SolveRun
from stiffopt.solver.stages import Outcome, run_stages
from stiffopt.solver.unsolved import (
    ON_PATH,
    as_good_as_can_be,
    below_the_base,
    bound_reason,
    fastest_on_path,
    hopeless,
    only_baseline,
    pinned_by_a_bound,
    solver_record,
)
from stiffopt.solver.verdict import baseline_above, beyond_limits, optimum_reach, verdict
from stiffopt.solver.way_around import led_around
from stiffopt.transcription.ocp import Guess

# Share of the best objective within which an optimum counts as the same.
_NEAR = 0.01
# Standard deviation of a random start's detour [rad], and of the skew of its timing on a path; no
# motion turns back within the range of the skew.
_DETOUR, _SKEW, _SKEW_RANGE = 0.2, 0.4, (-0.9, 0.9)
# How a solve ends where the duration may be too short for any motion.
_TOO_FAST = (SolveStatus.CERTIFICATE_FAILED, SolveStatus.INFEASIBLE, SolveStatus.ITERATION_LIMIT)
# Of what an objective need not be below, within which it counts as lowered to that.
_LOW = 1.1


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
        The second as `load_problem` returns it.
    progress : callable, optional
        Called with a `SolveProgress` in every iteration.
    guess : Guess or Assessment, optional
        Where to start, such as `guess` of an earlier solution; toppra's motion if left out.
    throw : bool
        Raise `NoSolutionFound` unless the status is optimal, acceptable or interrupted.
    simulate : bool
        Simulate the motion and its baselines on the elastic arm: `Solution.simulation`.
    start : int
        Above zero: begin with a random smooth detour of the guess, another for each number.

    Returns
    -------
    Solution

    Raises
    ------
    ProblemError
        The problem cannot be met or its objective is degenerate; said before solving.
    NoSolutionFound
        With the solution so far, where `throw` is set.
    """
    if isinstance(problem, LoadedProblem):
        problem = problem.problem
    solution, _ = solve_keeping(
        problem, progress=progress, guess=guess, simulate=simulate, start=start
    )
    if throw and not (solution.status.usable or solution.status is SolveStatus.INTERRUPTED):
        raise NoSolutionFound(solution.message, solution)
    return solution


def solve_keeping(
    problem: TrajectoryProblem,
    *,
    progress: ProgressCallback | None = None,
    guess: Guess | Assessment | None = None,
    simulate: bool = False,
    start: int = 0,
    compare: bool = True,
) -> tuple[Solution, tuple[SolveRun, Outcome] | None]:
    """As `solve`, and what was built for it: None where there was no programme of its own.

    Parameters
    ----------
    problem, progress, guess, simulate, start : as of `solve`
    compare : bool
        Look for the baseline that keeps every limit as well.
    """
    motion = resolve(problem)
    # Made beside all that comes before the first programme.
    frontal.library()
    # Meshes of the cell that cannot be read are told before the solve.
    _ = problem.clearance_model
    check_clear_poses(problem, motion)
    if simulate:
        check_simulation(problem, motion)
    notes = notes_before(problem, motion)
    # Their tables are those of the simulation.
    if simulate and (soft := questionable_springs(problem.robot, motion.start)):
        notes = (*notes, soft)
    beside = baselines(problem, motion)
    run = SolveRun(problem, motion, _scales(problem, beside), progress, beside.get("quintic"))
    needed, why = shortest_duration(problem, motion)
    kept = None
    if problem.duration[1] < needed:
        solution = hopeless(run, beside, notes, why)
    elif problem.is_shaped:
        inner = functools.partial(solve, progress=progress, guess=guess, throw=False)
        solution = solve_shaped(problem, motion, beside, notes, inner)
    elif (pinned := pinned_by_a_bound(run, beside)) is not None and not start:
        solution = as_good_as_can_be(run, beside, notes, pinned[0], bound_reason(pinned[1]))
    else:
        rival = better_baseline(problem, beside)
        try:
            delivered()
            begin = _begin(problem, motion, beside, guess)
            if start:
                random = np.random.default_rng([problem.method.seed, start])
                begin = _perturbed(begin, problem, random)
            outcome = _best_of_starts(run, begin, rival)
            rivals = _with_strict(beside, _strict(run, beside) if compare else None)
            outcome = _from_baseline_above(run, outcome, rivals, rival)
            kept = (run, outcome)
            if problem.avoids_collisions:
                outcome = led_around(run, outcome, rival, searches=problem.method.starts)
                # Its rows are of this motion only: nothing else can be solved from there.
                kept = None if run.avoidance else (run, outcome)
                beside |= {} if run.detour is None else {run.detour.name: run.detour}
            if (fastest := fastest_on_path(problem, outcome, beside)) is not None:
                solution, kept = as_good_as_can_be(run, beside, notes, fastest, ON_PATH), None
            else:
                robust = robust_plan(run, outcome)
                solution = solution_of(run, robust, beside, notes, compare=compare)
                shaped = functools.partial(_shaped_over, run, beside, notes, guess)
                solution = shaped_for_arms(run, solution, outcome, shaped)
        except KeyboardInterrupt:
            solution = only_baseline(run, beside, notes)
    if simulate:
        solution = with_simulation(problem, solution, progress, motion, run.command)
    return solution, kept


def _shaped_over(
    run: SolveRun,
    beside: dict[str, Baseline],
    notes: tuple[str, ...],
    guess: Guess | Assessment | None,
    windows: tuple[Window, ...],
) -> Solution:
    """The problem with its deviation shaped over windows, in what is left of its time."""
    left = max(run.problem.method.time_limit - run.elapsed, LEAST_TIME)
    shaped = tuple(replace(each, name="shaped_deviation") for each in run.problem.objectives)
    method = replace(run.problem.method, time_limit=left)
    problem = replace(run.problem, objectives=shaped, method=method)
    inner = functools.partial(solve, progress=run.progress, guess=guess, throw=False)
    return solve_shaped(problem, run.motion, beside, notes, inner, windows)


def _begin(
    problem: TrajectoryProblem,
    motion: ResolvedMotion,
    beside: dict[str, Baseline],
    guess: Guess | Assessment | None,
) -> Guess:
    """The guess itself, of an earlier motion, or of a baseline."""
    if guess is None:
        return initial_guess(problem, motion, beside)
    if isinstance(guess, Guess):
        return guess
    if guess.position.shape[1] != problem.joints:
        raise ProblemError(
            f"the guess has {guess.position.shape[1]} joints, {problem.robot.name} has"
            f" {problem.joints}. Take one of the same arm."
        )
    return guess_along(problem, motion, guess)


def notes_before(problem: TrajectoryProblem, motion: ResolvedMotion) -> tuple[str, ...]:
    """What can be said of a problem before it is solved; refuses those that are degenerate."""
    chosen = (problem.chosen,) if problem.chosen else ()
    doubted = (*inconsistent_inertias(problem.robot), *slack_belts(problem.robot))
    return (*chosen, *problem.remarks, *doubted, *_held(problem), *check_bounds(problem, motion))


def _held(problem: TrajectoryProblem) -> tuple[str, ...]:
    """Which joints of the URDF the arm does not move, where the file did not ask for it."""
    held = [str(each) for each in problem.robot.held if each.why != "locked"]
    return (f"Held, not planned: {'; '.join(held)}.",) if held else ()


def _scales(problem: TrajectoryProblem, beside: dict[str, Baseline]) -> Scales:
    """Typical values of the objectives: those of a baseline."""
    for baseline in beside.values():
        if baseline.assessment is not None:
            motion = baseline.assessment
            return Scales({o.name: o.kind.certified_value(o, motion) for o in problem.objectives})
    return Scales()


def _best_of_starts(run: SolveRun, guess: Guess, rival: Baseline | None) -> Outcome:
    """The best certified outcome of the problem's number of starts."""
    problem = run.problem
    random = np.random.default_rng(problem.method.seed)
    last = best = _certified_solve(run, guess, rival)
    made = [best]
    for start in range(1, problem.method.starts):
        ended = last.raw.status in ("interrupted", "time_limit")
        if ended or run.elapsed > problem.method.time_limit:
            run.notes.append(f"{start} of {problem.method.starts} starts were made.")
            break
        try:
            last = _certified_solve(run, _perturbed(guess, problem, random), rival)
        except KeyboardInterrupt:
            return stopped(best)
        made.append(last)
        run.starts_made = len(made)
        best = min(made, key=lambda outcome: rank(problem, outcome))
    if len(made) > 1:
        run.notes.append(_spread(problem, made))
    return best


def _from_baseline_above(
    run: SolveRun, outcome: Outcome, beside: dict[str, Baseline], rival: Baseline | None
) -> Outcome:
    """The better of an outcome and one begun from a baseline that is better than it."""
    above = baseline_above(run.problem, outcome, beside)
    late = run.elapsed > run.problem.method.time_limit
    if above is None or above.assessment is None or late or outcome.raw.status == "interrupted":
        return outcome
    if fastest_on_path(run.problem, outcome, beside) is not None:
        return outcome
    guess = guess_along(run.problem, run.motion, above.assessment)
    try:
        found = _certified_solve(run, guess, rival)
    except KeyboardInterrupt:
        return stopped(outcome)
    return min(outcome, found, key=lambda each: rank(run.problem, each))


def _spread(problem: TrajectoryProblem, made: list[Outcome]) -> str:
    """How far apart the optima of several starts lie."""
    found = [
        objective_value(problem, each.assessment).value
        for each in made
        if each.raw.converged and each.assessment.feasible(CERTIFIED)
    ]
    kept = f"Of {len(made)} starts {len(found)} ended in a certified optimum"
    if len(found) < 2:
        return f"{kept}."
    best = max(found) if is_maximised(problem) else min(found)
    off = [abs(value - best) / (abs(best) or 1.0) for value in found]
    near = f"{sum(each <= _NEAR for each in off)} within {100 * _NEAR:g} % of the best"
    return f"{kept}: {near}, the furthest {100 * max(off):.2g} % off."


def _certified_solve(run: SolveRun, guess: Guess, rival: Baseline | None) -> Outcome:
    """Solve in stages, then refine while the certificate finds more than is allowed."""
    plan = stages(run.problem, run.problem.method.intervals, run.corners)
    found = refined(run, run_stages(run, plan, guess, {}), rival)
    if run.end_modes and found.raw.status != "interrupted" and not _done(found):
        # What the motors' law leaves is more than the limits, or no optimum was found in time:
        # without any swing there is less.
        run.hold_at_rest()
        resting = found
        with suppress(KeyboardInterrupt):
            resting = refined(run, run_stages(run, plan, guess, {}), rival)
        if _done(resting) or not found.assessment.feasible(CERTIFIED):
            found = resting
            if found.assessment.feasible(CERTIFIED):
                run.notes.append(
                    "No motion was found whose links swing on after arrival as far as the limits "
                    "allow: this one brings them to rest, which takes a little longer."
                )
    return found


def _done(outcome: Outcome) -> bool:
    """Whether an outcome is an optimum that keeps all limits."""
    return outcome.raw.converged and outcome.assessment.feasible(CERTIFIED)


def _perturbed(guess: Guess, problem: TrajectoryProblem, random: np.random.Generator) -> Guess:
    """The guess with a smooth random detour that vanishes at both ends; on a path, other timing."""
    if problem.path is not None:
        return _retimed(guess, float(np.clip(random.normal(scale=_SKEW), *_SKEW_RANGE)))
    n = problem.joints
    amplitude = random.normal(scale=_DETOUR, size=n)

    def moved(s: np.ndarray) -> np.ndarray:
        values = np.array(guess.states(s))
        bump = 16.0 * (np.asarray(s) * (1.0 - np.asarray(s))) ** 2
        slope = 32.0 * np.asarray(s) * (1.0 - np.asarray(s)) * (1.0 - 2.0 * np.asarray(s))
        values[:, :n] += bump[:, None] * amplitude
        values[:, n : 2 * n] += slope[:, None] * amplitude / guess.duration
        return values

    return replace(guess, states=moved)


def _retimed(guess: Guess, skew: float) -> Guess:
    """The guess on a path, at the scaled time w where it was at t: w = t + skew t (1 - t)."""

    def warped(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return t + skew * t * (1.0 - t), (1.0 + skew * (1.0 - 2.0 * t))[:, None]

    def states(t: np.ndarray) -> np.ndarray:
        w, rate = warped(np.asarray(t))
        return np.asarray(guess.states(w) * np.hstack([np.ones_like(rate), rate]))

    def controls(t: np.ndarray) -> np.ndarray:
        w, rate = warped(np.asarray(t))
        speed = np.asarray(guess.states(w))[:, 1:]
        return np.asarray(guess.controls(w) * rate**2 - 2.0 * skew * speed / guess.duration)

    return replace(guess, states=states, controls=controls)


def solution_of(
    run: SolveRun,
    outcome: Outcome,
    beside: dict[str, Baseline],
    notes: tuple[str, ...],
    *,
    compare: bool = True,
) -> Solution:
    """The solution of an outcome; `compare` looks for the baseline that keeps every limit."""
    problem, assessment = run.problem, with_collisions(run.problem, outcome.assessment)
    strict = None
    if compare and outcome.raw.status != "infeasible":
        strict = _strict(run, beside)
    rivals = _with_strict(beside, strict)
    found = verdict(problem, outcome, assessment, rivals)
    if found.status is SolveStatus.OPTIMAL:
        reach = optimum_reach(problem, rivals, run.starts_made)
        found = replace(found, message=f"{found.message} {reach}")
    end = beyond_limits(problem, assessment, found, run.unavoided)
    slipping = slips(problem.robot, assessment)
    if slipping and slip_text(slipping) not in end.message:
        notes = (*notes, f"In this motion {slip_text(slipping)}")
    if not slipping and end.status in _TOO_FAST and not assessment.feasible(CERTIFIED):
        advice = slower_advice(run, outcome)
        end = replace(end, message=f"{end.message} {advice}".rstrip())
    value = objective_value(problem, assessment)
    rival = better_baseline(problem, beside)
    ratio = None
    if (
        rival is not None
        and rival.objective is not None
        and end.status is not SolveStatus.INFEASIBLE
    ):
        ratio = improvement(problem, value.value, rival.objective)
    if end.status is SolveStatus.INFEASIBLE:
        strict = None
    return Solution(
        status=end.status,
        message=end.message,
        trajectory=outcome.trajectory,
        assessment=assessment,
        objective=value,
        baselines=beside,
        ratio_to_better_baseline=ratio,
        solver=solver_record(run, len(outcome.transcription.intervals)),
        notes=(
            *notes,
            *run.notes,
            *_low_enough(run, value.value),
            *below_the_base(problem, assessment),
        ),
        inputs_hash=inputs_hash(problem),
        versions=versions(),
        strict_baseline=strict,
        ratio_to_strict_baseline=(
            None
            if strict is None or strict.objective is None
            else improvement(problem, value.value, strict.objective)
        ),
    )


def _low_enough(run: SolveRun, value: float) -> list[str]:
    """That a lower objective was not asked for, where that is so."""
    kind = run.problem.objectives[0].kind
    enough = kind.target_value(run.scales.of(kind.name))
    if len(run.problem.objectives) > 1 or not 0.0 < value <= _LOW * enough:
        return []
    return [
        f"The {kind.phrase} was lowered to {1e3 * enough:.2g} mm and no further: no arm repeats "
        "its path better, and less takes detours of the wrist."
    ]


def _strict(run: SolveRun, beside: dict[str, Baseline]) -> Baseline | None:
    """The baseline that keeps every limit, sought once; not looked for any more after Ctrl-C."""
    if run.strict is None:
        with suppress(KeyboardInterrupt):
            run.strict = strict_baseline(run.problem, run.motion, beside)
    return run.strict


def _with_strict(beside: dict[str, Baseline], strict: Baseline | None) -> dict[str, Baseline]:
    """All motions that may be better than the optimised one."""
    return beside if strict is None else beside | {strict.name: strict}
