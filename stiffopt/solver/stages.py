"""One staged solve: coarse before fine, wide smoothing before narrow; then the motion assessed."""

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
from stiffopt.problem.motor_model import WIDER
from stiffopt.problem.smoothing import Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.joint_path import JointPath
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.ipopt import FEASIBLE, IpoptSolver, Multipliers, RawSolution
from stiffopt.solver.monitor import Progress
from stiffopt.solver.near_optimum import NearOptimum
from stiffopt.solver.phase_one import least_excess
from stiffopt.solver.plan import SolveStage, solver_options
from stiffopt.solver.solve_run import SolveProgress, SolveRun
from stiffopt.symbolic import array_of
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import Mesh, refine_mesh, split_counts, uniform_mesh
from stiffopt.transcription.nlp import BlockScales, Nlp
from stiffopt.transcription.ocp import Guess, OptimalControlProblem
from stiffopt.transcription.transcription import Transcription

# Excess of all rows together, relative to their scales, from which on they are in conflict; and
# that on a coarse mesh which no finer one mends.
_CONFLICT = 1e-4
_HOPELESS = 0.5
# How often planes are laid anew at most; the objective has settled when it falls by no more.
_ROUNDS, _COARSE_ROUNDS = 12, 2
_SETTLED = 2e-5
# What planes exceed falls to this share, or they are not laid anew.
_NEARER = 0.7
# Excess of a row, relative to its scale, up to which a start is near the optimum.
_NEAR = 1.0
# And that from which on it is a corner of the motors' law passed fast.
_SPIKE = 10.0
# Of a start whose bounds have been drawn in, from them.
_PUSH = 1e-3
# Intervals of a fixed path for each piece of its spline, at whose ends the rate of its curvature
# jumps: limits that fewer do not see are exceeded between the nodes.
_PER_PIECE = 3
# Instants at which a guess is asked when it passes the knots of a path; and the time for a piece at
# least, as a share of the average, where the guess is at rest.
_PATH_INSTANTS, _LEAST_SHARE = 20001, 1e-2


@dataclass(frozen=True)
class Outcome:
    """End of one staged solve: the last NLP and what its motion is worth.

    Parameters
    ----------
    raw : RawSolution
    transcription : Transcription
    trajectory : Trajectory
    assessment : Assessment
    objective_gap : float
        How much worse the certified objective is than the one at the nodes, relative.
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
        Shares by which limits are tightened.
    mesh : Mesh, optional
        Of the first stage; uniform if left out.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C before the first stage has begun; later the outcome so far is kept.
    """
    done: tuple[Programme, SolveStage, RawSolution] | None = None
    try:
        for each in _solved(run, plan, guess, margins, mesh):
            done = each
    except KeyboardInterrupt:
        # While the next programme was built: what the one before gave is the best so far.
        if done is None:
            raise
        done = *done[:2], replace(done[2], status="interrupted", reason="Ctrl-C")
    assert done is not None
    made, stage, raw = done
    return outcome_of(run, made, raw, stage.smoothing)


def solve_again(run: SolveRun, before: Outcome, nlp: Nlp, smoothing: Smoothing) -> Outcome:
    """Solve the last stage again from where it ended, with other bounds or smoothing."""
    made = Programme(before.transcription, before.solver)
    return outcome_of(run, made, corrected(run, made, before.raw, nlp, smoothing), smoothing)


def corrected(
    run: SolveRun, made: Programme, before: RawSolution, nlp: Nlp, smoothing: Smoothing
) -> RawSolution:
    """As `solve_again`, without looking at the motion."""
    made.solver.rebound(nlp)
    stage = SolveStage(len(made.transcription.intervals), smoothing)
    return solve_stage(run, made, stage, before.x, before, "correction", "adaptive", _PUSH)


def motors_of(run: SolveRun, outcome: Outcome, share: float, *, sagged: bool) -> Trajectory:
    """Motors of the same links by a law with this share of the outcome's smoothing widths.

    With springs that carry the links where they hang, or where they are planned.
    """
    law, x = share * outcome.smoothing.law, outcome.raw.x
    return _trajectory(run, outcome.transcription, x, law, sagged=sagged)


def _solved(
    run: SolveRun,
    plan: tuple[SolveStage, ...],
    guess: Guess,
    margins: dict[str, float],
    mesh: Mesh | None,
) -> Iterator[tuple[Programme, SolveStage, RawSolution]]:
    """Every stage with its solution, each from the last."""
    ocp = formulate(run.problem, run.motion, run.scales, margins, run.end_modes)
    if run.lag is not None:
        # The links arrive before their motors.
        shortest, longest = (each - float(run.lag.max()) for each in ocp.duration)
        ocp = replace(ocp, duration=(shortest, longest))
    last = len(plan) - 1
    index, made, raw = 0, None, None
    warm: RawSolution | None = None
    while index <= last:
        stage = plan[index]
        if made is None or raw is None:
            first = mesh or _first_mesh(run.problem, ocp, stage, guess)
            made = build_programme(run, ocp, first, guess)
            x = made.transcription.pack(guess)
        elif stage.new_mesh:
            guess = made.transcription.guess_from(raw.x)
            finer = finer_mesh(
                run.problem, made.transcription, raw.x, _resolving(run.problem, stage)
            )
            made = build_programme(run, ocp, finer, guess, smoothing=stage.smoothing)
            if run.problem.plans_links:
                stage = _no_spike(stage, plan[index - 1], made.transcription, guess)
            x, warm = made.transcription.pack(guess), None
        else:
            x, warm = raw.x, raw if raw.converged else None
        label = f"stage {index + 1} of {len(plan)}"
        raw = solve_stage(run, made, stage, x, warm, label)
        raw, hopeless = _looked_into(run, made, stage, x, raw, last=index == last)
        if run.avoidance is not None:
            rounds = _ROUNDS if index == last else _COARSE_ROUNDS
            made, raw = _kept_clear(run, made, stage, x, raw, label, rounds)
        yield made, stage, raw
        if hopeless or raw.status in ("interrupted", "time_limit"):
            break
        # A coarse mesh may be infeasible where the fine one is not: ask the last stage at once.
        index = last if raw.status == "infeasible" and index < last else index + 1


def _looked_into(
    run: SolveRun,
    made: Programme,
    stage: SolveStage,
    x: np.ndarray,
    raw: RawSolution,
    *,
    last: bool,
) -> tuple[RawSolution, bool]:
    """A stage from `x` that met no end: its answer, and whether no further stage can help.

    Where its rows are exceeded, the motion that exceeds them least shows whether they can hold. A
    coarse mesh and wide smoothing tell less than the last stage does, so more is asked of them.
    """
    ended = raw.converged or raw.status in ("interrupted", "time_limit")
    if ended or raw.violation <= FEASIBLE or not made.transcription.nlp.derivatives:
        return raw, False
    nlp, parameters = made.solver.nlp, stage.smoothing.parameters
    begin = time.perf_counter()
    # From where the stage began: what led nowhere has led away.
    found = least_excess(nlp, x, parameters, run.remaining)
    run.solve_s += time.perf_counter() - begin
    run.iterations += found.iterations
    if found.status in ("interrupted", "time_limit"):
        return replace(raw, status=found.status), True
    if found.converged and found.excess > (_CONFLICT if last else _HOPELESS):
        conflicts = found.conflicts
        return replace(raw, x=found.x, status="infeasible", conflicts=conflicts), True
    if found.converged and found.excess <= _CONFLICT:
        # There are motions that keep all rows: on from one of them.
        again = solve_stage(run, made, stage, found.x, None, "from a feasible motion")
        return (again if again.converged else raw), False
    return raw, False


def _kept_clear(
    run: SolveRun,
    made: Programme,
    stage: SolveStage,
    x: np.ndarray,
    raw: RawSolution,
    label: str,
    rounds: int,
) -> tuple[Programme, RawSolution]:
    """A stage from `x` solved again with its planes laid anew, until the objective has settled."""
    avoidance = run.avoidance
    assert avoidance is not None
    for number in range(1, rounds + 1):
        if raw.status in ("interrupted", "time_limit"):
            break
        begin = time.perf_counter()
        same, clear = False, not avoidance.ran_into(raw.x)
        if clear or not raw.converged:
            # Where planes leave no motion, those of the nearest one may.
            x = raw.x
            transcription, same = avoidance.renewed(made.transcription, x)
        else:
            # On from where it was clear, with rows for what it ran into.
            transcription = avoidance.begun_again(x)
        if same:
            made.solver.rebound(transcription.nlp)
        again = Programme(transcription, made.solver) if same else _solvable(run, transcription)
        run.build_s += time.perf_counter() - begin
        text = f"{label}, clear of collisions, round {number}"
        warm = raw if same and raw.converged else None
        found = solve_stage(run, again, stage, x, warm, text, "adaptive")
        ended = found.status in ("interrupted", "time_limit")
        if raw.converged and not found.converged:
            made.solver.rebound(made.transcription.nlp)
            return made, replace(raw, status=found.status) if ended else raw
        fell = raw.objective - found.objective
        settled = raw.converged and same and fell <= _SETTLED * abs(found.objective)
        stuck = not found.converged and found.violation > _NEARER * raw.violation
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
) -> RawSolution:
    """Solve one stage; where it stalls, once more from the best point without multipliers."""
    report = _reporter(
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
        )
        run.record(stage, raw)
        if raw.status != "stalled":
            break
        # Once more from the best point, without the multipliers that led astray.
        x = raw.x
    return raw


def solve_near(
    run: SolveRun, made: Programme, stage: SolveStage, x: np.ndarray, warm: Multipliers
) -> RawSolution | None:
    """A stage from the optimum of a near problem by what binds there; None where that fails."""
    if made.near is None:
        return None
    report = _reporter(run, f"near, {stage.intervals} intervals")
    raw = made.near.solve(made.transcription, x, stage.smoothing.parameters, warm, report)
    if raw is not None:
        run.record(stage, raw)
    return raw


def outcome_of(run: SolveRun, made: Programme, raw: RawSolution, smoothing: Smoothing) -> Outcome:
    """The motion of a solved stage, with its certificate."""
    trajectory = _trajectory(run, made.transcription, raw.x, smoothing.law)
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
    """How much worse the certified objective is than the one at the nodes, relative."""
    problem = run.problem
    if not all(objective.kind.comparable for objective in problem.objectives):
        return 0.0
    certified = objective_value(problem, assessment).value
    claimed = run.in_si(raw.objective)
    if smoothing.robust:
        plain = replace(smoothing, robust=0.0).parameters
        claimed = run.in_si(transcription.unpack(raw.x, plain).objective)
    worse = claimed - certified if is_maximised(problem) else certified - claimed
    return float(worse / max(abs(claimed), abs(certified), 1e-300))


@dataclass(frozen=True)
class Programme:
    """A transcribed problem with its solver.

    Parameters
    ----------
    transcription : Transcription
    solver : IpoptSolver
    near : NearOptimum, optional
        For problems near one that is solved.
    """

    transcription: Transcription
    solver: IpoptSolver
    near: NearOptimum | None = None


def build_programme(
    run: SolveRun,
    ocp: OptimalControlProblem,
    mesh: Mesh,
    guess: Guess | None = None,
    scales: BlockScales | None = None,
    smoothing: Smoothing | None = None,
) -> Programme:
    """Transcribe a problem on a mesh, with its own scales or given ones, and set up its solver.

    Where the motion is to be kept clear of collisions, `guess` says what comes near. With a
    `smoothing` it is the motion of a coarser mesh, from which the solve begins.
    """
    begin = time.perf_counter()
    transcription = transcribe(ocp, run.problem.method.transcription, mesh, scales=scales)
    if run.avoidance is not None and guess is not None:
        transcription = run.avoidance.added(transcription, transcription.pack(guess))
    near = False
    if guess is not None and smoothing is not None:
        near = _near(transcription, guess, smoothing)
    made = _solvable(run, transcription, near=near)
    run.build_s += time.perf_counter() - begin
    return made


def _solvable(run: SolveRun, transcription: Transcription, *, near: bool = False) -> Programme:
    options = solver_options(run.problem, near=near)
    return Programme(transcription, IpoptSolver(transcription.nlp, options))


def _near(transcription: Transcription, guess: Guess, smoothing: Smoothing) -> bool:
    """Whether a guess exceeds no row by much."""
    return _excess(transcription, guess, smoothing) <= _NEAR


def _no_spike(
    stage: SolveStage, before: SolveStage, transcription: Transcription, guess: Guess
) -> SolveStage:
    """The stage with as wide corners of the motors' law as the motion before it needs.

    Passed fast, a narrow corner asks for many times a motor's jerk: no solve gets rid of that.
    """
    smoothing = stage.smoothing
    widest = before.smoothing.law
    while smoothing.law < widest and _excess(transcription, guess, smoothing) > _SPIKE:
        smoothing = replace(smoothing, corners=2.0 * smoothing.corners)
    return replace(stage, smoothing=smoothing)


def _excess(transcription: Transcription, guess: Guess, smoothing: Smoothing) -> float:
    """The largest by which a guess exceeds a row, relative to its scale."""
    nlp = transcription.nlp
    rows = ca.Function("rows", [nlp.x, nlp.p], [nlp.g])
    found = rows(transcription.pack(guess), nlp.parameters(smoothing.parameters))
    return float(nlp.violations(array_of(found)).max(initial=0.0))


def _first_mesh(
    problem: TrajectoryProblem, ocp: OptimalControlProblem, stage: SolveStage, guess: Guess
) -> Mesh:
    """Even intervals within each phase, or within each piece of a fixed path."""
    if problem.path is not None:
        return _path_mesh(problem.path, guess, _resolving(problem, stage))
    return uniform_mesh(stage.intervals, ocp.phases, tuple(guess.phase_fractions))


def finer_mesh(
    problem: TrajectoryProblem, before: Transcription, x: np.ndarray, intervals: int
) -> Mesh:
    """Mesh for the motion `x`: short where its controls change, on a path between its waypoints."""
    if problem.path is not None:
        return _path_mesh(problem.path, before.guess_from(x), intervals)
    return refine_mesh(before, x, intervals)


def _path_mesh(waypoints: np.ndarray, guess: Guess, intervals: int) -> Mesh:
    """Mesh with nodes where a motion passes the waypoints, at which the curvature's rate jumps.

    Parameters
    ----------
    waypoints : array (m, n)
    guess : Guess
        The motion: path coordinate and its speed.
    intervals : int
    """
    at = np.linspace(0.0, 1.0, _PATH_INSTANTS)
    knots = JointPath.through(waypoints).knots
    shares = np.diff(np.interp(knots, guess.states(at)[:, 0], at))
    shares = np.maximum(shares, _LEAST_SHARE / len(shares))
    shares /= shares.sum()
    counts = split_counts(intervals, shares, _PER_PIECE)
    return [np.repeat(shares / counts, counts)]


def _resolving(problem: TrajectoryProblem, stage: SolveStage) -> int:
    """Intervals of a stage, no fewer than show where the pieces of a fixed path bend."""
    pieces = 0 if problem.path is None else len(problem.path) - 1
    return max(stage.intervals, _PER_PIECE * pieces)


def _trajectory(
    run: SolveRun,
    transcription: Transcription,
    x: np.ndarray,
    law: float,
    *,
    sagged: bool = False,
) -> Trajectory:
    """The motion of the joints, exactly as the transcription integrates it."""
    problem = run.problem
    motion = Trajectory.from_acceleration(*transcription.acceleration_polynomials(x))
    if problem.plans_links:
        return run.motors.motion(motion, WIDER * law, run.lag, sagged=sagged)
    if problem.path is None:
        return motion
    return JointPath.through(problem.path).follow(motion)


def _reporter(run: SolveRun, label: str) -> Callable[[Progress], None] | None:
    if run.progress is None:
        return None
    report = run.progress

    def forward(event: Progress) -> None:
        value = run.in_si(event.objective)
        report(
            SolveProgress(label, event.iteration, value, event.violation, event.row, run.elapsed)
        )

    return forward
