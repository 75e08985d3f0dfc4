"""Programmes of a solve: transcribed, solved, and certified as outcomes."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import casadi as ca
import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.certificate.collisions import COLLISION_LIMIT, with_collisions
from stiffopt.certificate.objective_value import is_maximised, objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.motor_model import LAW_SMOOTHING_FACTOR
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.result.status import SolveProgress
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.active_set import ActiveSetSolver
from stiffopt.solver.exchange import keep_better
from stiffopt.solver.ipopt import WARM_BARRIER, IpoptSolver, Multipliers, RawSolution
from stiffopt.solver.monitor import FEASIBLE_VIOLATION, Progress
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import MANY_PHASES, NEAR_BOUND_PUSH, SolveStage, solver_options
from stiffopt.symbolic import array_of
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import BlockScales, Nlp
from stiffopt.transcription.ocp import Guess, OptimalControlProblem
from stiffopt.transcription.transcription import Transcription

if TYPE_CHECKING:
    from stiffopt.solver.vibration_suppression import SimulatedMotors

# Excess of a row, relative to its scale, up to which a guess counts as near the optimum.
_NEAR_GUESS_EXCESS = 1.0
# A correction starts at an optimum: beyond the iterations that this took, and at least so many, it
# is unlikely to converge.
_MIN_CORRECTION_ITERATIONS = 150
# Objective of a correction over the one that the multipliers predict, up to which a stalled one is
# acceptable.
_MAX_STALLED_RISE = 1e-2
# Least distance from bounds of a start that has nearly the same active ones: a similar problem's,
# or a correction's with many phases, most of which keep their motion. An adaptive barrier would
# leave it first: initial barrier after a rough solve, and after another one over the tolerance, at
# which it stays.
WARM_BOUND_PUSH = 1e-4
_ROUGH_BARRIER, _SOLVED_BARRIER_SHARE = 1e-7, 0.5


@dataclass(frozen=True)
class Outcome:
    """End of one staged solve: the last NLP with its certified motion."""

    raw: RawSolution
    transcription: Transcription
    planned: Trajectory  # as integrated by the transcription, of the links or of the path parameter
    trajectory: Trajectory
    assessment: Assessment
    objective_gap: float  # relative excess of the certified objective over the one at the nodes
    solver: IpoptSolver
    smoothing: Smoothing  # of the last stage
    nlp: Nlp  # with the bounds of this solve
    problem: TrajectoryProblem
    arm: SimulatedMotors | None = None  # simulated arm, of motors that suppress its vibration
    slowed: str = ""  # why and by how much it was slowed

    @property
    def failed(self) -> bool:
        """True where the solve ended neither at an optimum nor by its time."""
        return not self.raw.converged and self.raw.status != "time_limit"

    @property
    def clear(self) -> bool:
        """True where all limits and clearances hold."""
        return self.assessment.feasible(CERTIFICATE_TOLERANCE) and not self.collisions

    @functools.cached_property
    def collisions(self) -> list[Violation]:
        """Collision violations of the certificate, worst first."""
        motion = with_collisions(self.problem, self.assessment)
        return [
            v
            for v in motion.violations
            if v.limit == COLLISION_LIMIT and v.value > CERTIFICATE_TOLERANCE
        ]


@dataclass(frozen=True)
class Programme:
    """A transcribed problem with its solver."""

    transcription: Transcription
    solver: IpoptSolver
    near: ActiveSetSolver | None = None  # for problems similar to a solved one


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
    near = (
        guess is not None
        and smoothing is not None
        and largest_excess(transcription, guess, smoothing) <= _NEAR_GUESS_EXCESS
    )
    made = attach_solver(run, transcription, near=near)
    run.build_s += time.perf_counter() - begin
    return made


def attach_solver(run: SolveRun, transcription: Transcription, *, near: bool = False) -> Programme:
    """Return a transcribed programme with its solver; `near` where it starts near the optimum."""
    options = solver_options(run.problem, near=near)
    return Programme(transcription, IpoptSolver(transcription.nlp, options))


def largest_excess(transcription: Transcription, guess: Guess, smoothing: Smoothing) -> float:
    """Return the largest excess of a row at a guess, relative to its scale."""
    nlp = transcription.nlp
    rows = ca.Function("rows", [nlp.x, nlp.p], [nlp.g])
    found = rows(transcription.pack(guess), nlp.parameters(smoothing.parameters))
    return float(nlp.violations(array_of(found)).max(initial=0.0))


def solve_again(
    run: SolveRun,
    before: Outcome,
    nlp: Nlp,
    smoothing: Smoothing,
    max_iterations: int | None = None,
) -> Outcome:
    """Solve the last stage again from where it ended, with other bounds or smoothing.

    A correction that ends at a feasible point of about the predicted objective is acceptable,
    though it stalls or needs its last iteration: whether it converges there may hang on rounding.
    """
    made, raw = Programme(before.transcription, before.solver), before.raw
    made.solver.set_bounds(nlp)
    many = made.transcription.ocp.phases >= MANY_PHASES and not run.problem.plans_links
    # A rough solve has its last digits before it.
    most = None if raw.rough else max(raw.iterations, _MIN_CORRECTION_ITERATIONS)
    last = _ROUGH_BARRIER if raw.rough else _SOLVED_BARRIER_SHARE * made.solver.options.tol
    again = solve_stage(
        run,
        made,
        SolveStage(len(made.transcription.intervals), smoothing),
        raw.x,
        raw,
        "correction",
        "monotone" if many else "adaptive",
        WARM_BOUND_PUSH if many else NEAR_BOUND_PUSH,
        max_iterations or most,
        raw.objective + predict_rise(before, nlp) + _MAX_STALLED_RISE * abs(raw.objective),
        last if many else WARM_BARRIER,
    )
    return certify_outcome(run, made, again, smoothing)


def predict_rise(before: Outcome, nlp: Nlp) -> float:
    """Return the first-order rise of the optimal objective with the bounds of rows that moved."""
    own, old = before.raw.multipliers_g, before.nlp
    with np.errstate(invalid="ignore"):
        closer = np.where(own > 0.0, old.upper_g - nlp.upper_g, nlp.lower_g - old.lower_g)
    return float(np.abs(own) @ np.where(np.isfinite(closer), closer, 0.0))


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
    mu_init: float = WARM_BARRIER,
) -> RawSolution:
    """Solve one stage; after a stall once more from the best point without multipliers.

    A stall, or an end of the iterations, at a feasible point whose objective is `enough` or less is
    acceptable. Raises `KeyboardInterrupt` after Ctrl-C during the solve.
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
            mu_init=mu_init,
            push=push,
            tolerance=stage.tolerance,
            report=report,
            max_seconds=run.remaining,
            max_iterations=max_iterations or run.max_iterations,
        )
        feasible = raw.violation <= FEASIBLE_VIOLATION
        ended = raw.status in ("stalled", "iteration_limit")
        if ended and feasible and raw.objective <= enough:
            raw = replace(raw, status="acceptable", reason=raw.status)
        run.record(stage, raw)
        if raw.status == "interrupted":
            run.unfinished = functools.partial(certify_outcome, run, made, raw, stage.smoothing)
            raise KeyboardInterrupt
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
    """Return the certified motion of a solved stage, kept where it is the best so far."""
    planned = Trajectory.from_acceleration(*made.transcription.acceleration_polynomials(raw.x))
    trajectory = follow_plan(run, planned, smoothing.law)
    assessment = assess(run.problem, trajectory)
    outcome = Outcome(
        raw=raw,
        transcription=made.transcription,
        planned=planned,
        trajectory=trajectory,
        assessment=assessment,
        objective_gap=_objective_gap(run, made.transcription, raw, smoothing, assessment),
        solver=made.solver,
        smoothing=smoothing,
        nlp=made.solver.nlp,
        problem=run.problem,
    )
    return keep_better(run, outcome)


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


def motors_with_law(run: SolveRun, outcome: Outcome, share: float, *, sagged: bool) -> Trajectory:
    """Return motors of the same links by a law with a share of the outcome's smoothing widths.

    With `sagged` the spring torques are those at the sagged, else at the planned link positions.
    """
    return follow_plan(run, outcome.planned, share * outcome.smoothing.law, sagged=sagged)


def follow_plan(
    run: SolveRun, motion: Trajectory, law: float, *, sagged: bool = False
) -> Trajectory:
    """Return the motion of the joints by a planned motion."""
    problem = run.problem
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
