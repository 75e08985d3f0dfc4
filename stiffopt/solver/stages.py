"""Staged solve: from coarse mesh and wide smoothing to fine and narrow, then the certificate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca
import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.certificate.objective_value import is_maximised, objective_value
from stiffopt.problem.formulation import formulate
from stiffopt.problem.motor_model import LAW_SMOOTHING_FACTOR
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.result.assessment import Assessment
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.active_set import ActiveSetSolver
from stiffopt.solver.infeasibility import minimise_excess
from stiffopt.solver.ipopt import IpoptSolver, Multipliers, RawSolution
from stiffopt.solver.monitor import FEASIBLE_VIOLATION, Progress
from stiffopt.solver.solve_run import SolveProgress, SolveRun
from stiffopt.solver.stage_plan import (
    SolveStage,
    finer_mesh,
    initial_mesh,
    resolving_intervals,
    solver_options,
)
from stiffopt.symbolic import array_of
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import BlockScales, Nlp
from stiffopt.transcription.ocp import Guess, OptimalControlProblem
from stiffopt.transcription.transcription import Transcription

# Sum of the excesses of all rows, relative to their scales, from which on they are in conflict; and
# that on a coarse mesh which no finer one removes.
_MIN_CONFLICT_EXCESS = 1e-4
_HOPELESS_COARSE_EXCESS = 0.5
# Updates of separating planes in the last and in earlier stages, and relative decrease of the
# objective below which they end.
_MAX_PLANE_ROUNDS, _MAX_COARSE_PLANE_ROUNDS = 12, 2
_MIN_RELATIVE_DECREASE = 2e-5
# Share to which an infeasible violation must fall for another update.
_MAX_REMAINING_VIOLATION = 0.7
# Excess of a row, relative to its scale, up to which a guess counts as near the optimum.
_NEAR_GUESS_EXCESS = 1.0
# And that from which on it comes from passing a kink of the motor law fast.
_SPIKE_EXCESS = 10.0
# A correction starts at an optimum: beyond the iterations that this took, and at least so many, it
# is unlikely to converge.
_MIN_CORRECTION_ITERATIONS = 150
# Rise of the objective by a correction, relative, up to which a stalled one is acceptable.
_MAX_STALLED_RISE = 1e-2
# Least distance from backed-off bounds of a correction's start.
_CORRECTION_BOUND_PUSH = 1e-3


@dataclass(frozen=True)
class Outcome:
    """End of one staged solve: the last NLP with its certified motion.

    Parameters
    ----------
    raw : RawSolution
    transcription : Transcription
    trajectory : Trajectory
    assessment : Assessment
    objective_gap : float
        Relative excess of the certified objective over the one at the nodes.
    solver : IpoptSolver
    smoothing : Smoothing
        Of the last stage.
    """

    raw: RawSolution
    transcription: Transcription
    trajectory: Trajectory
    assessment: Assessment
    objective_gap: float
    solver: IpoptSolver
    smoothing: Smoothing


def run_stages(
    run: SolveRun,
    plan: tuple[SolveStage, ...],
    guess: Guess,
    margins: dict[str, float],
    mesh: Mesh | None = None,
) -> Outcome:
    """Solve the stages one after another, each from the last.

    Parameters
    ----------
    run : SolveRun
    plan : tuple of SolveStage
    guess : Guess
    margins : dict
        Back-off of limits, as shares.
    mesh : Mesh, optional
        Of the first stage; uniform if left out.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C before the first stage has started; later the outcome so far is returned.
    """
    done: tuple[Programme, SolveStage, RawSolution] | None = None
    try:
        for each in _iterate_stages(run, plan, guess, margins, mesh):
            done = each
    except KeyboardInterrupt:
        # While the next programme was built: the stage before has the best result so far.
        if done is None:
            raise
        done = *done[:2], replace(done[2], status="interrupted", reason="Ctrl-C")
    assert done is not None
    made, stage, raw = done
    return certify_outcome(run, made, raw, stage.smoothing)


def solve_again(run: SolveRun, before: Outcome, nlp: Nlp, smoothing: Smoothing) -> Outcome:
    """Solve the last stage again from where it ended, with other bounds or smoothing."""
    made = Programme(before.transcription, before.solver)
    return certify_outcome(
        run, made, solve_correction(run, made, before.raw, nlp, smoothing), smoothing
    )


def solve_correction(
    run: SolveRun,
    made: Programme,
    before: RawSolution,
    nlp: Nlp,
    smoothing: Smoothing,
    max_iterations: int | None = None,
) -> RawSolution:
    """Solve as `solve_again`, without the certificate.

    A correction that stalls at a feasible point of about the objective before is acceptable.
    """
    made.solver.set_bounds(nlp)
    stage = SolveStage(len(made.transcription.intervals), smoothing)
    return solve_stage(
        run,
        made,
        stage,
        before.x,
        before,
        "correction",
        "adaptive",
        _CORRECTION_BOUND_PUSH,
        max_iterations or max(before.iterations, _MIN_CORRECTION_ITERATIONS),
        before.objective + _MAX_STALLED_RISE * abs(before.objective),
    )


def motors_with_law(run: SolveRun, outcome: Outcome, share: float, *, sagged: bool) -> Trajectory:
    """Return motors of the same links by a law with a share of the outcome's smoothing widths.

    With `sagged` the spring torques are those at the sagged, else at the planned link positions.
    """
    law, x = share * outcome.smoothing.law, outcome.raw.x
    return _build_trajectory(run, outcome.transcription, x, law, sagged=sagged)


def _iterate_stages(
    run: SolveRun,
    plan: tuple[SolveStage, ...],
    guess: Guess,
    margins: dict[str, float],
    mesh: Mesh | None,
) -> Iterator[tuple[Programme, SolveStage, RawSolution]]:
    """Yield every stage with its solution, each started from the last."""
    ocp = formulate(run.problem, run.motion, run.scales, margins, run.end_modes)
    if run.lag is not None:
        # By damping the links arrive before their motors.
        shortest, longest = (each - float(run.lag.max()) for each in ocp.duration)
        ocp = replace(ocp, duration=(shortest, longest))
    last = len(plan) - 1
    index, made, raw = 0, None, None
    warm: RawSolution | None = None
    while index <= last:
        stage = plan[index]
        if made is None or raw is None:
            first = mesh or initial_mesh(run.problem, ocp, stage, guess)
            made = build_programme(run, ocp, first, guess)
            x = made.transcription.pack(guess)
        elif stage.new_mesh:
            guess = made.transcription.guess_from(raw.x)
            finer = finer_mesh(
                run.problem, made.transcription, raw.x, resolving_intervals(run.problem, stage)
            )
            made = build_programme(run, ocp, finer, guess, smoothing=stage.smoothing)
            if run.problem.plans_links:
                stage = _widen_until_no_spike(stage, plan[index - 1], made.transcription, guess)
            x, warm = made.transcription.pack(guess), None
        else:
            x, warm = raw.x, raw if raw.converged else None
        label = f"stage {index + 1} of {len(plan)}"
        raw = solve_stage(run, made, stage, x, warm, label)
        raw, hopeless = _analyse_failed_stage(run, made, stage, x, raw, last=index == last)
        if run.avoidance is not None:
            rounds = _MAX_PLANE_ROUNDS if index == last else _MAX_COARSE_PLANE_ROUNDS
            made, raw = _resolve_with_new_planes(run, made, stage, x, raw, label, rounds)
        yield made, stage, raw
        if hopeless or raw.status in ("interrupted", "time_limit"):
            break
        # A coarse mesh may be infeasible where the fine one is not: continue with the last stage.
        index = last if raw.status == "infeasible" and index < last else index + 1


def _analyse_failed_stage(
    run: SolveRun,
    made: Programme,
    stage: SolveStage,
    x: np.ndarray,
    raw: RawSolution,
    *,
    last: bool,
) -> tuple[RawSolution, bool]:
    """Analyse a stage from `x` that has not converged; return its result and True if hopeless.

    The motion of least excess shows whether the rows can hold. A coarse mesh and wide smoothing
    prove less than the last stage does, so a larger excess is required of them.
    """
    ended = raw.converged or raw.status in ("interrupted", "time_limit")
    if ended or raw.violation <= FEASIBLE_VIOLATION or not made.transcription.nlp.derivatives:
        return raw, False
    nlp, parameters = made.solver.nlp, stage.smoothing.parameters
    begin = time.perf_counter()
    # From the start of the stage: its last iterate has diverged.
    found = minimise_excess(nlp, x, parameters, run.remaining)
    run.solve_s += time.perf_counter() - begin
    run.iterations += found.iterations
    if found.status in ("interrupted", "time_limit"):
        return replace(raw, status=found.status), True
    if found.converged and found.excess > (
        _MIN_CONFLICT_EXCESS if last else _HOPELESS_COARSE_EXCESS
    ):
        conflicts = found.conflicts
        return replace(raw, x=found.x, status="infeasible", conflicts=conflicts), True
    if found.converged and found.excess <= _MIN_CONFLICT_EXCESS:
        # Feasible motions exist: continue from the one found.
        again = solve_stage(run, made, stage, found.x, None, "from a feasible motion")
        return (again if again.converged else raw), False
    return raw, False


def _resolve_with_new_planes(
    run: SolveRun,
    made: Programme,
    stage: SolveStage,
    x: np.ndarray,
    raw: RawSolution,
    label: str,
    rounds: int,
) -> tuple[Programme, RawSolution]:
    """Solve a stage from `x` again with updated planes until the objective has converged."""
    avoidance = run.avoidance
    assert avoidance is not None
    for number in range(1, rounds + 1):
        if raw.status in ("interrupted", "time_limit"):
            break
        begin = time.perf_counter()
        same, clear = False, not avoidance.collides_elsewhere(raw.x)
        if clear or not raw.converged:
            # Where the planes leave no feasible motion, those of the nearest one may.
            x = raw.x
            transcription, same = avoidance.update_planes(made.transcription, x)
        else:
            # Restart from the collision-free point, with rows for the couples that collided.
            transcription = avoidance.rows_at(x)
        if same:
            made.solver.set_bounds(transcription.nlp)
        again = (
            Programme(transcription, made.solver) if same else _attach_solver(run, transcription)
        )
        run.build_s += time.perf_counter() - begin
        text = f"{label}, clear of collisions, round {number}"
        warm = raw if same and raw.converged else None
        found = solve_stage(run, again, stage, x, warm, text, "adaptive")
        ended = found.status in ("interrupted", "time_limit")
        if raw.converged and not found.converged:
            made.solver.set_bounds(made.transcription.nlp)
            return made, replace(raw, status=found.status) if ended else raw
        fell = raw.objective - found.objective
        settled = raw.converged and same and fell <= _MIN_RELATIVE_DECREASE * abs(found.objective)
        stuck = not found.converged and found.violation > _MAX_REMAINING_VIOLATION * raw.violation
        made, raw = again, found
        if settled or stuck:
            break
    return made, raw


def solve_stage(
    run: SolveRun,
    made: Programme,
    stage: SolveStage,
    x: np.ndarray,
    warm: Multipliers | None,
    text: str,
    barrier: Literal["monotone", "adaptive"] = "monotone",
    push: float = 1e-8,
    max_iterations: int | None = None,
    enough: float = -np.inf,
) -> RawSolution:
    """Solve one stage; after a stall once more from the best point without multipliers.

    A stall at a feasible point whose objective is `enough` or less is acceptable.
    """
    report = _progress_reporter(
        run, f"{text}, {stage.intervals} intervals, smoothing {stage.smoothing.stiffness:g}"
    )
    for start in (warm, None):
        raw = made.solver.solve(
            x,
            stage.smoothing.parameters,
            warm=start,
            barrier=barrier,
            push=push,
            report=report,
            max_seconds=run.remaining,
            max_iterations=max_iterations,
        )
        if (
            raw.status == "stalled"
            and raw.violation <= FEASIBLE_VIOLATION
            and raw.objective <= enough
        ):
            raw = replace(raw, status="acceptable")
        run.record(stage, raw)
        if raw.status != "stalled":
            break
        # Multipliers of a stalled solve mislead the next one.
        x = raw.x
    return raw


def solve_by_active_set(
    run: SolveRun, made: Programme, stage: SolveStage, x: np.ndarray, warm: Multipliers
) -> RawSolution | None:
    """Solve a stage from the active set of a similar problem's optimum; None where that fails."""
    if made.near is None:
        return None
    report = _progress_reporter(run, f"active set, {stage.intervals} intervals")
    raw = made.near.solve(made.transcription, x, stage.smoothing.parameters, warm, report)
    if raw is not None:
        run.record(stage, raw)
    return raw


def certify_outcome(
    run: SolveRun, made: Programme, raw: RawSolution, smoothing: Smoothing
) -> Outcome:
    """Return the motion of a solved stage with its certificate."""
    trajectory = _build_trajectory(run, made.transcription, raw.x, smoothing.law)
    assessment = assess(run.problem, trajectory)
    return Outcome(
        raw=raw,
        transcription=made.transcription,
        trajectory=trajectory,
        assessment=assessment,
        objective_gap=_objective_gap(run, made.transcription, raw, smoothing, assessment),
        solver=made.solver,
        smoothing=smoothing,
    )


def _objective_gap(
    run: SolveRun,
    transcription: Transcription,
    raw: RawSolution,
    smoothing: Smoothing,
    assessment: Assessment,
) -> float:
    """Return the relative excess of the certified objective over the one at the nodes."""
    problem = run.problem
    if not all(objective.kind.comparable for objective in problem.objectives):
        return 0.0
    certified = objective_value(problem, assessment).value
    claimed = run.reported_value(raw.objective)
    if smoothing.robust:
        plain = replace(smoothing, robust=0.0).parameters
        claimed = run.reported_value(transcription.unpack(raw.x, plain).objective)
    worse = claimed - certified if is_maximised(problem) else certified - claimed
    return float(worse / max(abs(claimed), abs(certified), 1e-300))


@dataclass(frozen=True)
class Programme:
    """A transcribed problem with its solver.

    Parameters
    ----------
    transcription : Transcription
    solver : IpoptSolver
    near : ActiveSetSolver, optional
        For problems similar to a solved one.
    """

    transcription: Transcription
    solver: IpoptSolver
    near: ActiveSetSolver | None = None


def build_programme(
    run: SolveRun,
    ocp: OptimalControlProblem,
    mesh: Mesh,
    guess: Guess | None = None,
    scales: BlockScales | None = None,
    smoothing: Smoothing | None = None,
) -> Programme:
    """Transcribe a problem on a mesh, with its own scales or given ones, and set up its solver.

    With collision avoidance, `guess` determines the near couples. With a `smoothing` it is the
    motion of a coarser mesh, from which the solve starts.
    """
    begin = time.perf_counter()
    transcription = transcribe(ocp, run.problem.method.transcription, mesh, scales=scales)
    if run.avoidance is not None and guess is not None:
        transcription = run.avoidance.add_rows(transcription, transcription.pack(guess))
    near = False
    if guess is not None and smoothing is not None:
        near = _is_near_guess(transcription, guess, smoothing)
    made = _attach_solver(run, transcription, near=near)
    run.build_s += time.perf_counter() - begin
    return made


def _attach_solver(run: SolveRun, transcription: Transcription, *, near: bool = False) -> Programme:
    options = solver_options(run.problem, near=near)
    return Programme(transcription, IpoptSolver(transcription.nlp, options))


def _is_near_guess(transcription: Transcription, guess: Guess, smoothing: Smoothing) -> bool:
    """Return True where a guess exceeds all rows by little."""
    return _largest_excess(transcription, guess, smoothing) <= _NEAR_GUESS_EXCESS


def _widen_until_no_spike(
    stage: SolveStage, before: SolveStage, transcription: Transcription, guess: Guess
) -> SolveStage:
    """Return the stage with the motor law's smoothing as wide as the motion before it needs.

    Passed fast, a kink with a narrow smoothing needs many times a motor's jerk limit, from which no
    solve converges.
    """
    smoothing = stage.smoothing
    widest = before.smoothing.law
    while (
        smoothing.law < widest and _largest_excess(transcription, guess, smoothing) > _SPIKE_EXCESS
    ):
        smoothing = replace(smoothing, lead=2.0 * smoothing.lead)
    return replace(stage, smoothing=smoothing)


def _largest_excess(transcription: Transcription, guess: Guess, smoothing: Smoothing) -> float:
    """Return the largest excess of a row at a guess, relative to its scale."""
    nlp = transcription.nlp
    rows = ca.Function("rows", [nlp.x, nlp.p], [nlp.g])
    found = rows(transcription.pack(guess), nlp.parameters(smoothing.parameters))
    return float(nlp.violations(array_of(found)).max(initial=0.0))


def _build_trajectory(
    run: SolveRun,
    transcription: Transcription,
    x: np.ndarray,
    law: float,
    *,
    sagged: bool = False,
) -> Trajectory:
    """Return the motion of the joints, exactly as the transcription integrates it."""
    problem = run.problem
    motion = Trajectory.from_acceleration(*transcription.acceleration_polynomials(x))
    if problem.plans_links:
        return run.motors.motion(motion, LAW_SMOOTHING_FACTOR * law, run.lag, sagged=sagged)
    if problem.path is None:
        return motion
    return problem.path.follow(motion)


def _progress_reporter(run: SolveRun, label: str) -> Callable[[Progress], None] | None:
    if run.progress is None:
        return None
    report = run.progress

    def forward(event: Progress) -> None:
        value = run.reported_value(event.objective)
        report(
            SolveProgress(label, event.iteration, value, event.violation, event.row, run.elapsed)
        )

    return forward
