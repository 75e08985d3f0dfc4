"""Staged solve: from coarse mesh and wide smoothing to fine and narrow, then the certificate."""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from stiffopt.command.smoothing_width import MAX_DOUBLINGS
from stiffopt.solver.exchange import exchange
from stiffopt.solver.infeasibility import minimise_excess
from stiffopt.solver.ipopt import RawSolution
from stiffopt.solver.monitor import FEASIBLE_VIOLATION
from stiffopt.solver.plane_updates import PlaneUpdates, StageEnd
from stiffopt.solver.programme import (
    Outcome,
    Programme,
    build_programme,
    certify_outcome,
    largest_excess,
    solve_stage,
)
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import SolveStage, finer_mesh, initial_mesh, resolving_intervals
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.ocp import Guess
from stiffopt.transcription.transcription import Transcription

# Sum of the excesses of all rows, relative to their scales, from which on they are in conflict; and
# that on a coarse mesh which no finer one removes.
_MIN_CONFLICT_EXCESS = 1e-4
_HOPELESS_COARSE_EXCESS = 0.5
# Excess of a row, relative to its scale, from which on it comes from passing a kink of the motor
# law fast.
_SPIKE_EXCESS = 10.0


def run_stages(
    run: SolveRun,
    plan: tuple[SolveStage, ...],
    guess: Guess,
    margins: dict[str, float],
    mesh: Mesh | None = None,
) -> Outcome:
    """Solve the stages one after another, each from the last.

    `margins` back limits off, as shares; `mesh` is that of the first stage, else uniform.
    """
    for made, stage, raw in _iterate_stages(run, plan, guess, margins, mesh):
        last = functools.partial(certify_outcome, run, made, raw, stage.smoothing)
        run.unfinished = last
    return last()


def _iterate_stages(
    run: SolveRun,
    plan: tuple[SolveStage, ...],
    guess: Guess,
    margins: dict[str, float],
    mesh: Mesh | None,
) -> Iterator[tuple[Programme, SolveStage, RawSolution]]:
    """Yield every stage with its solution, each started from the last."""
    ocp = run.formulate(margins)
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
                stage = _widen_until_no_spike(stage, made.transcription, guess)
            x, warm = made.transcription.pack(guess), None
        else:
            x, warm = raw.x, raw if raw.converged else None
        label = f"stage {index + 1} of {len(plan)}"
        raw = solve_stage(run, made, stage, x, warm, label)
        raw, hopeless = _analyse_failed_stage(run, made, stage, x, raw, last=index == last)
        if run.avoidance is not None:
            planes = PlaneUpdates(run, run.avoidance, stage, x, last=index == last)
            end = exchange(run, planes, StageEnd(made, raw))
            made, raw = end.made, end.raw
        yield made, stage, raw
        if hopeless or raw.status == "time_limit":
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
    ended = raw.converged or raw.status == "time_limit"
    if ended or raw.violation <= FEASIBLE_VIOLATION or not made.transcription.nlp.derivatives:
        return raw, False
    nlp, parameters = made.solver.nlp, stage.smoothing.parameters
    begin = time.perf_counter()
    # From the start of the stage: its last iterate has diverged.
    found = minimise_excess(nlp, x, parameters, run.remaining)
    run.solve_s += time.perf_counter() - begin
    run.iterations += found.iterations
    if found.status == "interrupted":
        raise KeyboardInterrupt
    if found.status == "time_limit":
        return replace(raw, status=found.status), True
    hopeless = _MIN_CONFLICT_EXCESS if last else _HOPELESS_COARSE_EXCESS
    if found.converged and found.excess > hopeless:
        return replace(raw, x=found.x, status="infeasible", conflicts=found.conflicts), True
    if found.converged and found.excess <= _MIN_CONFLICT_EXCESS:
        # Feasible motions exist: continue from the one found.
        again = solve_stage(run, made, stage, found.x, None, "from a feasible motion")
        return (again if again.converged else raw), False
    return raw, False


def _widen_until_no_spike(
    stage: SolveStage, transcription: Transcription, guess: Guess
) -> SolveStage:
    """Return the stage with the motor law's smoothing as wide as the motion before it needs.

    Passed fast, a kink with a narrow smoothing needs many times a motor's jerk limit, from which no
    solve converges. That of the coarse mesh may be too narrow too: it is passed between its nodes.
    """
    own = stage.smoothing
    for _ in range(MAX_DOUBLINGS):
        if largest_excess(transcription, guess, own) <= _SPIKE_EXCESS:
            break
        own = replace(own, lead=2.0 * own.lead)
    return replace(stage, smoothing=own)
