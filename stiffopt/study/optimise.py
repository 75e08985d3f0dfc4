"""Solve a trajectory problem: baselines, staged collocation, certificate, refinement.

The optimiser sees the smoothed model at nodes and midpoints; the certificate judges the motion with
the exact model on a fine grid. A limit found exceeded there is tightened by the excess on a finer
mesh, up to three times, or the solve ends as `certificate_failed`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stiffopt.baseline.joint_path import JointPath
from stiffopt.certificate.assess import assess
from stiffopt.certificate.objective_value import improvement, objective_value, term_value
from stiffopt.errors import NoSolutionFound
from stiffopt.problem.bounds import check_bounds
from stiffopt.problem.formulation import Scales, formulate
from stiffopt.problem.resolve import ResolvedMotion, resolve
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import Baseline, Solution, SolverRecord
from stiffopt.result.status import SolveStatus
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.ipopt import IpoptSolver, RawSolution
from stiffopt.solver.options import IpoptOptions
from stiffopt.study.baselines import baselines, better_baseline
from stiffopt.study.guess import initial_guess
from stiffopt.study.provenance import inputs_hash, versions
from stiffopt.study.stages import Stage, smoothing_widths, stages
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.ocp import Guess
from stiffopt.transcription.transcription import Transcription

# A limit exceeded by more than this share between nodes fails the certificate.
CERTIFIED = 5e-3
# Motions are tightened until the excess is below this, so that 0.5 % is never only just met.
_AIM = 2e-3
_REFINEMENTS = 3


@dataclass(frozen=True)
class SolveProgress:
    """One iteration, for displays.

    Attributes
    ----------
    stage : str
        Which of how many, intervals and smoothing.
    iteration : int
    objective : float
        In SI, of the smoothed model at the nodes.
    violation : float
        Worst row, relative to its scale.
    row : str
        Its name; empty when nothing is violated.
    elapsed : float
        Since the solve began [s].
    """

    stage: str
    iteration: int
    objective: float
    violation: float
    row: str
    elapsed: float


ProgressCallback = Callable[[SolveProgress], object]


@dataclass
class _Run:
    """One solve in progress: its clock, its record and what it found so far."""

    problem: TrajectoryProblem
    motion: ResolvedMotion
    scales: Scales
    progress: ProgressCallback | None
    begin: float = field(default_factory=time.perf_counter)
    build_s: float = 0.0
    solve_s: float = 0.0
    iterations: int = 0
    homotopy: list[dict[str, Any]] = field(default_factory=list)

    @property
    def elapsed(self) -> float:
        return time.perf_counter() - self.begin

    @property
    def remaining(self) -> float:
        return max(self.problem.method.time_limit - self.elapsed, 0.1)


@dataclass(frozen=True)
class _Outcome:
    """End of one staged solve: the last NLP and what its motion is worth."""

    raw: RawSolution
    transcription: Transcription
    trajectory: Trajectory
    assessment: Assessment


def solve(
    problem: TrajectoryProblem,
    *,
    progress: ProgressCallback | None = None,
    guess: Guess | None = None,
    throw: bool = True,
) -> Solution:
    """Optimise a motion and certify it.

    Parameters
    ----------
    problem : TrajectoryProblem
    progress : callable, optional
        Called with a `SolveProgress` in every iteration.
    guess : Guess, optional
        Where to start; toppra's motion if left out.
    throw : bool
        Raise `NoSolutionFound` unless the status is optimal, acceptable or interrupted.

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
    motion = resolve(problem)
    notes = check_bounds(problem, motion)
    beside = baselines(problem, motion)
    scales = _scales(problem, beside)
    run = _Run(problem, motion, scales, progress)
    outcome = _best_of_starts(run, guess or initial_guess(problem, motion, beside))
    solution = _conclude(run, outcome, beside, notes)
    if throw and not (solution.status.usable or solution.status is SolveStatus.INTERRUPTED):
        raise NoSolutionFound(solution.message, solution)
    return solution


def _scales(problem: TrajectoryProblem, beside: dict[str, Baseline]) -> Scales:
    """Typical values of the objectives: those of a baseline."""
    for baseline in beside.values():
        if baseline.assessment is not None:
            motion = baseline.assessment
            return Scales(
                {o.name: term_value(o, motion, problem.joints) for o in problem.objectives}
            )
    return Scales()


def _best_of_starts(run: _Run, guess: Guess) -> _Outcome:
    """The best certified outcome of the problem's number of starts."""
    problem = run.problem
    random = np.random.default_rng(problem.method.seed)
    best = _certified_solve(run, guess)
    for _ in range(problem.method.starts - 1):
        if best.raw.status in ("interrupted", "time_limit"):
            break
        other = _certified_solve(run, _perturbed(guess, problem, random))
        best = min(best, other, key=lambda outcome: _rank(problem, outcome))
    return best


def _rank(problem: TrajectoryProblem, outcome: _Outcome) -> tuple[bool, float]:
    """Certified outcomes first, then by objective."""
    value = objective_value(problem, outcome.assessment).value
    maximised = len(problem.objectives) == 1 and problem.objectives[0].maximised
    return not outcome.assessment.feasible(CERTIFIED), -value if maximised else value


def _certified_solve(run: _Run, guess: Guess) -> _Outcome:
    """Solve in stages; refine the mesh and tighten limits while the certificate finds excess."""
    margins: dict[str, float] = {}
    intervals = run.problem.method.intervals
    plan = stages(run.problem, intervals)
    for attempt in range(_REFINEMENTS + 1):
        outcome = _staged(run, plan, guess, margins)
        excess = _excess(outcome.assessment)
        stopped = outcome.raw.status in ("interrupted", "time_limit", "infeasible")
        if not excess or stopped or attempt == _REFINEMENTS:
            break
        for name, value in excess.items():
            margins[name] = margins.get(name, 0.0) + value
        intervals = int(np.ceil(1.25 * intervals))
        plan = (Stage(intervals, smoothing_widths(run.problem)[-1]),)
        guess = outcome.transcription.guess_from(outcome.raw.x)
    return outcome


def _excess(assessment: Assessment) -> dict[str, float]:
    """Limits exceeded by more than the aim, with the excess; targets cannot be tightened."""
    fixed = ("start", "end", "via")
    return {
        v.limit: v.value
        for v in assessment.violations
        if v.value > _AIM and not v.limit.startswith(fixed)
    }


def _staged(
    run: _Run, plan: tuple[Stage, ...], guess: Guess, margins: dict[str, float]
) -> _Outcome:
    problem = run.problem
    ocp = formulate(problem, run.motion, run.scales, margins)
    made: tuple[int, Transcription, IpoptSolver] | None = None
    x: np.ndarray | None = None
    previous: RawSolution | None = None
    for number, stage in enumerate(plan, start=1):
        if made is None or made[0] != stage.intervals:
            begin = time.perf_counter()
            mesh = uniform_mesh(stage.intervals, ocp.phases, guess.phase_fractions)
            transcription = transcribe(ocp, problem.method.transcription, mesh)
            options = IpoptOptions(
                tol=problem.method.tolerance, max_iterations=problem.method.max_iterations
            )
            made = (stage.intervals, transcription, IpoptSolver(transcription.nlp, options))
            x, previous = transcription.pack(guess), None
            run.build_s += time.perf_counter() - begin
        _, transcription, solver = made
        assert x is not None
        label = (
            f"stage {number} of {len(plan)}, {stage.intervals} intervals, "
            f"smoothing {stage.smoothing:g}"
        )
        raw = solver.solve(
            x,
            np.array([stage.smoothing]),
            warm=previous,
            report=_reporter(run, label),
            max_seconds=run.remaining,
        )
        _record(run, stage, raw)
        x, previous = raw.x, raw if raw.converged else None
        guess = transcription.guess_from(raw.x)
        if raw.status in ("interrupted", "time_limit"):
            break
    trajectory = _trajectory(problem, transcription, raw.x)
    return _Outcome(raw, transcription, trajectory, assess(problem, trajectory))


def _trajectory(
    problem: TrajectoryProblem, transcription: Transcription, x: np.ndarray
) -> Trajectory:
    """The motion of the joints, exactly as the transcription integrates it."""
    motion = Trajectory.from_acceleration(*transcription.acceleration_polynomials(x))
    if problem.path is None:
        return motion
    return JointPath.through(problem.path).follow(motion)


def _reporter(run: _Run, label: str) -> Callable[[Any], None] | None:
    if run.progress is None:
        return None
    report = run.progress
    first = run.problem.objectives[0]
    size = first.weight * run.scales.of(first.name)
    sign = -1.0 if len(run.problem.objectives) == 1 and first.maximised else 1.0

    def forward(event: Any) -> None:
        value = sign * event.objective * size
        report(
            SolveProgress(
                label, event.iteration, value, event.violation, event.row, run.elapsed
            )
        )

    return forward


def _record(run: _Run, stage: Stage, raw: RawSolution) -> None:
    run.solve_s += raw.solve_s
    run.iterations += raw.iterations
    run.homotopy.append(
        {
            "intervals": stage.intervals,
            "smoothing": stage.smoothing,
            "iterations": raw.iterations,
            "status": raw.status,
            "solve_s": round(raw.solve_s, 4),
        }
    )


def _perturbed(guess: Guess, problem: TrajectoryProblem, random: np.random.Generator) -> Guess:
    """The guess with a smooth random detour that vanishes at both ends."""
    states: Any = guess.states
    n = problem.joints if problem.path is None else 1
    amplitude = random.normal(scale=0.2 if problem.path is None else 0.0, size=n)

    def moved(s: np.ndarray) -> np.ndarray:
        values = np.array(states(s))
        bump = 16.0 * (np.asarray(s) * (1.0 - np.asarray(s))) ** 2
        slope = 32.0 * np.asarray(s) * (1.0 - np.asarray(s)) * (1.0 - 2.0 * np.asarray(s))
        values[:, :n] += bump[:, None] * amplitude
        values[:, n:] += slope[:, None] * amplitude / guess.duration
        return values

    return Guess(
        states=moved,
        controls=guess.controls,
        duration=guess.duration,
        statics=guess.statics,
        phase_fractions=guess.phase_fractions,
    )


def _conclude(
    run: _Run, outcome: _Outcome, beside: dict[str, Baseline], notes: tuple[str, ...]
) -> Solution:
    problem, raw, assessment = run.problem, outcome.raw, outcome.assessment
    status = _status(raw, assessment)
    value = objective_value(problem, assessment)
    rival = better_baseline(problem, beside)
    ratio = None
    if rival is not None and rival.objective is not None and status is not SolveStatus.INFEASIBLE:
        ratio = improvement(problem, value.value, rival.objective)
    return Solution(
        status=status,
        message=_message(status, raw, assessment),
        trajectory=outcome.trajectory,
        assessment=assessment,
        objective=value,
        baselines=beside,
        ratio_to_better_baseline=ratio,
        solver=SolverRecord(
            iterations=run.iterations,
            build_s=run.build_s,
            solve_s=run.solve_s,
            transcription=problem.method.transcription,
            intervals=len(outcome.transcription.intervals.shares),
            homotopy=tuple(run.homotopy),
        ),
        notes=notes,
        inputs_hash=inputs_hash(problem),
        versions=versions(),
    )


def _status(raw: RawSolution, assessment: Assessment) -> SolveStatus:
    certified = assessment.feasible(CERTIFIED)
    if raw.converged:
        if not certified:
            return SolveStatus.CERTIFICATE_FAILED
        return SolveStatus.OPTIMAL if raw.status == "optimal" else SolveStatus.ACCEPTABLE
    if raw.status == "infeasible" or (raw.status == "stalled" and not certified):
        return SolveStatus.INFEASIBLE
    if raw.status in ("interrupted", "time_limit"):
        return SolveStatus(raw.status)
    return SolveStatus.ITERATION_LIMIT


def _message(status: SolveStatus, raw: RawSolution, assessment: Assessment) -> str:
    text = status.sentence
    if status in (SolveStatus.INFEASIBLE, SolveStatus.TIME_LIMIT, SolveStatus.ITERATION_LIMIT):
        rows = "; ".join(str(row) for row in raw.worst_rows[:3])
        text += f" Rows that conflict: {rows}." if rows else ""
        if raw.status == "invalid_number":
            text += f" {raw.reason}."
    elif status is not SolveStatus.INTERRUPTED:
        text += f" Worst of all limits: {assessment.worst_violation.describe()}."
    if status is SolveStatus.INTERRUPTED:
        certified = assessment.feasible(CERTIFIED)
        text += (
            " It keeps all limits." if certified else
            f" It does not keep all limits: {assessment.worst_violation.describe()}."
        )
    return text
