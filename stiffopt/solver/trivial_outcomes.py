"""Outcomes without an optimum: infeasible duration, baseline at a bound, Ctrl-C; advice."""

from __future__ import annotations

import math

from stiffopt.baseline.baselines import better_baseline, slowed_quintic
from stiffopt.certificate.objective_value import improvement, is_maximised, objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.bounds import find_bounds
from stiffopt.problem.objective import Bound
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.provenance import inputs_hash, versions
from stiffopt.result.solution import Baseline, Solution, SolverRecord
from stiffopt.result.status import SolveStatus
from stiffopt.solver.programme import Outcome
from stiffopt.solver.slowing import slow_down
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.verdict import Verdict, judge_collisions

# Relative distance from a bound up to which an objective counts as at it.
_AT_BOUND_SHARE = 1e-3
# Depth of the tool below the base's origin from which on a note warns [m].
_MIN_DEPTH_BELOW_BASE = 0.01
# Trial factors on the duration of a failed motion.
_DURATION_FACTORS = (1.01, 1.02, 1.04, 1.06, 1.08, 1.12, 1.16, 1.24, 1.32, 1.5)
# Factor on a just feasible duration that leaves a reserve for back-off.
_DURATION_RESERVE = 1.03


def infeasible_solution(
    run: SolveRun, compared: dict[str, Baseline], notes: tuple[str, ...], why: str
) -> Solution:
    """Return the solution where the limits of one joint already exclude every motion."""
    return Solution(
        status=SolveStatus.INFEASIBLE,
        message=f"No motion can be that fast. {why} Allow a longer duration or raise that limit.",
        trajectory=None,
        assessment=None,
        objective=None,
        baselines=compared,
        ratio_to_better_baseline=None,
        solver=solver_record(run, 0),
        notes=notes,
        inputs_hash=inputs_hash(run.problem),
        versions=versions(),
    )


def baseline_at_bound(
    run: SolveRun, compared: dict[str, Baseline]
) -> tuple[Baseline, Bound] | None:
    """Return a baseline that keeps all limits and attains the objective's bound, and that bound."""
    problem = run.problem
    bounds = find_bounds(problem, run.motion) if len(problem.objectives) == 1 else ()
    if not bounds or any(bound.degenerate for bound in bounds):
        return None
    sign = -1.0 if is_maximised(problem) else 1.0
    bound = max(bounds, key=lambda each: sign * each.value)
    for baseline in compared.values():
        motion, value = baseline.assessment, baseline.objective
        kept = baseline.feasible and motion is not None and motion.feasible(CERTIFICATE_TOLERANCE)
        if (
            kept
            and value is not None
            and sign * (value - bound.value) <= _AT_BOUND_SHARE * abs(bound.value)
        ):
            return baseline, bound
    return None


def explain_bound(bound: Bound) -> str:
    """Return the reason why a baseline at a bound is the optimum, as the rest of a sentence."""
    return (
        f"no motion is better by more than {_AT_BOUND_SHARE:.1%}. {bound.text} To gain anything, "
        "choose other poses or another objective."
    )


def baseline_as_optimum(
    run: SolveRun,
    compared: dict[str, Baseline],
    notes: tuple[str, ...],
    best: Baseline,
    reason: str,
) -> Solution:
    """Return a baseline's motion as the optimum; `reason` says why none is better."""
    problem, motion = run.problem, best.assessment
    assert motion is not None
    rival = better_baseline(problem, compared)
    ratio = None
    if rival is not None and rival.objective is not None and best.objective is not None:
        ratio = improvement(problem, best.objective, rival.objective)
    end = judge_collisions(
        problem,
        motion,
        Verdict(
            SolveStatus.OPTIMAL,
            f"The {best.name} motion is the optimum: it keeps every limit, and {reason}",
        ),
    )
    return Solution(
        status=end.status,
        message=end.message,
        trajectory=best.trajectory,
        assessment=motion,
        objective=objective_value(problem, motion),
        baselines=compared,
        ratio_to_better_baseline=ratio,
        solver=solver_record(run, 0),
        notes=(*notes, *run.notes, *below_base_warning(problem, motion)),
        inputs_hash=inputs_hash(problem),
        versions=versions(),
        strict_baseline=best,
        ratio_to_strict_baseline=1.0,
    )


def interrupted_with_baseline(
    run: SolveRun, compared: dict[str, Baseline], notes: tuple[str, ...]
) -> Solution:
    """Return a baseline where Ctrl-C came before the optimiser had a motion.

    The better one, or the one that exceeds its limits least.
    """
    problem = run.problem
    made = [(b.assessment.worst_violation.value, b) for b in compared.values() if b.assessment]
    kept = better_baseline(problem, compared)
    if kept is None and made:
        kept = min(made, key=lambda each: each[0])[1]
    if kept is None or kept.trajectory is None or kept.assessment is None:
        raise KeyboardInterrupt
    worst = kept.assessment.worst_violation
    keeps = kept.assessment.feasible(CERTIFICATE_TOLERANCE)
    state = "It keeps all limits." if keeps else f"It exceeds {worst.describe()}."
    return Solution(
        status=SolveStatus.INTERRUPTED,
        message="Stopped by the user before the optimiser had a motion. The result is a baseline, "
        f"the {kept.name} motion. {state}",
        trajectory=kept.trajectory,
        assessment=kept.assessment,
        objective=objective_value(problem, kept.assessment),
        baselines=compared,
        ratio_to_better_baseline=None,
        solver=solver_record(run, 0),
        notes=(*notes, *run.notes),
        inputs_hash=inputs_hash(problem),
        versions=versions(),
    )


def below_base_warning(problem: TrajectoryProblem, assessment: Assessment) -> tuple[str, ...]:
    """Return a warning where the tool goes below the base's origin along the base's z."""
    lowest = float(assessment.tool[:, 2].min())
    on_base = problem.robot.tool.seen_from is None
    if not on_base or lowest > -_MIN_DEPTH_BELOW_BASE or problem.stated_cell.floor is not None:
        return ()
    return (
        f"The tool goes to {-1e3 * lowest:.0f} mm below the origin of the base (along its z axis)."
        " No floor or table is described: state cell.floor to have it checked.",
    )


def solver_record(run: SolveRun, intervals: int) -> SolverRecord:
    """Return the solver's record of a run."""
    return SolverRecord(
        iterations=run.iterations,
        build_s=run.build_s,
        solve_s=run.solve_s,
        transcription=run.problem.method.transcription,
        intervals=intervals,
        homotopy=tuple(run.homotopy),
        exchanges=tuple(run.exchanges),
        left_out=tuple(run.left_out),
    )


def feasible_duration_advice(run: SolveRun, outcome: Outcome) -> str:
    """Return a sentence on a verified feasible duration; "" where none is known.

    For links planned in a fixed time from rest to rest. Excesses fall with the second or third
    power of the duration, at kinks of the motor law faster still.
    """
    shortest, longest = run.problem.duration
    if run.lag is None or shortest < longest:
        return ""
    slowed = slowed_quintic(run.problem, run.motion)
    tried = {
        "the same": _feasible_duration_of_links(run, outcome),
        "the quintic": None if slowed is None else slowed.duration,
    }
    known = {name: each for name, each in tried.items() if each is not None}
    if not known:
        return ""
    name, duration = min(known.items(), key=lambda each: each[1])
    # Rounded up: the stated duration must be feasible.
    step = 10.0 ** (math.floor(math.log10(duration)) - 2)
    kept, roomy = (
        f"{math.ceil(each / step) * step:.6g} s"
        for each in (duration, _DURATION_RESERVE * duration)
    )
    return (
        f"In {kept} {name} motion keeps every limit: "
        f'motion.duration = "{roomy}" leaves the solver a reserve.'
    )


def _feasible_duration_of_links(run: SolveRun, outcome: Outcome) -> float | None:
    """Return a duration [s] in which an outcome's links, with new motors, keep every limit."""
    slower = (slow_down(run, outcome, times) for times in _DURATION_FACTORS)
    return next((each.trajectory.duration for each in slower if each and each.clear), None)
