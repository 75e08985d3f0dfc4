"""Refinement of a motion that fails its certificate: finer mesh, constraint back-off, new solve.

A rigid plan (motors and links move alike) is solved on a finer mesh, then with backed-off limits. A
motion planned for the links keeps its mesh, since long chains of integrators converge poorly on a
new one: each row is backed off where the exact one exceeds it.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from stiffopt.certificate.assess import assess, drive_violations
from stiffopt.certificate.objective_value import improvement, is_maximised, objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.errors import NotSimulatedError
from stiffopt.problem.formulation import exact_path_rows
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.result.solution import Baseline
from stiffopt.solver.ipopt import RawSolution
from stiffopt.solver.smoothing_width import (
    KINK_EXCESS,
    MAX_REMAINING_EXCESS,
    TOLERABLE_KINK_EXCESS,
    narrowest_sufficient_width,
)
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import SolveStage, finer_mesh
from stiffopt.solver.stages import (
    Outcome,
    Programme,
    certify_outcome,
    motors_with_law,
    run_stages,
    solve_again,
    solve_correction,
)
from stiffopt.solver.stationary_joints import fix_creeping_joints
from stiffopt.solver.verdict import MAX_OBJECTIVE_GAP
from stiffopt.solver.vibration_suppression import SimulatedMotors, suppress_vibration
from stiffopt.transcription.constraint_back_off import (
    Excess,
    KnownRows,
    back_off_exceeded,
    back_off_uniformly,
    path_row_excess,
)
from stiffopt.transcription.nlp import Nlp
from stiffopt.transcription.point_function import PointFunction

# Back-off continues until the excess is below this: a margin to the certificate's tolerance.
_TARGET_EXCESS = 0.8 * CERTIFICATE_TOLERANCE
# Objective gap that is worth a finer mesh where a baseline is better.
_RIVAL_OBJECTIVE_GAP = 1e-3
_MAX_REFINEMENTS = 3
# Solves with creeping joints fixed, iterations of the one before them that finds these, and phases
# up to which they are tried: with more, some of the many fixed joints are in conflict.
_MAX_STATIONARY_SOLVES, _MAX_CREEPING_ITERATIONS, _MAX_STATIONARY_PHASES = 2, 60, 7
_MESH_GROWTH = 1.25
_MAX_CORRECTIONS = 12
# Largest back-off of a row in one step, as a share of its bound: a larger excess is a narrow peak,
# which less back-off removes.
_MAX_BACK_OFF_STEP = 0.15
# Share of an excess that the exact rows must show, else its cause lies outside the rows.
_MIN_EXPLAINED_SHARE = 0.5
# Share of the drive limits that the first back-off reserves for vibration suppression.
_DRIVE_LIMITS, _DRIVE_RESERVE = ("velocity", "acceleration", "jerk", "torque"), 0.04
# Share of the jerk limit, which kinks of the stiffness use most, in each later back-off.
_JERK_RESERVE = 0.15
# Deviation of the simulated arm from its plan, in flight and after arrival, over the plan's peak.
_MAX_PLAN_DEVIATION = 5e-2
# Share of the stiffness smoothing widths at which rows are checked where the objective is worse
# than predicted: kinks that the widths conceal show.
_CHECK_SMOOTHING_SHARE = 0.1
# Shares of the motor law's smoothing widths, tried when all limits hold: at half of it the residual
# vibration is that of the exact law.
_SHARPER_LAW_SHARES = (0.5, 0.6, 0.7, 0.8, 0.9)
# Excess that no correction removes: the smoothing is widened before the first one.
_SPIKE_EXCESS = 4.0


def refine(run: SolveRun, outcome: Outcome, rival: Baseline | None) -> Outcome:
    """Refine an outcome until its certificate passes.

    Also where a feasible baseline, the `rival`, is better only because of the objective gap between
    the nodes.
    """
    run.step = "constraint back-off"
    if run.problem.plans_links:
        return refine_within_mesh(run, outcome, outcome.transcription.nlp)
    return _refine_mesh(run, outcome, rival)


def _refine_mesh(run: SolveRun, outcome: Outcome, rival: Baseline | None) -> Outcome:
    """Solve on finer meshes, short where the controls change; from the second on with back-off."""
    margins: dict[str, float] = {}
    outcome = _fix_stationary_joints(run, outcome)
    for attempt in range(1, _MAX_REFINEMENTS + 1):
        excess = _excess_by_limit(outcome.assessment)
        true = (
            _RIVAL_OBJECTIVE_GAP
            if _is_worse_than(run.problem, outcome, rival)
            else MAX_OBJECTIVE_GAP
        )
        if not outcome.raw.converged or not (excess or outcome.objective_gap > true):
            break
        if attempt > 1 and run.problem.path is not None:
            # All limits are path rows, which are backed off only where they are exceeded.
            return _back_off_rows(run, outcome, outcome.transcription.nlp)[0]
        if attempt > 1:
            for name, value in excess.items():
                margins[name] = backed_off(margins.get(name, 0.0), value)
        before = outcome.transcription
        intervals = int(np.ceil(len(before.intervals) * _MESH_GROWTH))
        guess = before.guess_from(outcome.raw.x)
        mesh = finer_mesh(run.problem, before, outcome.raw.x, intervals)
        stage = SolveStage(intervals, outcome.smoothing)
        try:
            finer = run_stages(run, (stage,), guess, margins, mesh)
        except KeyboardInterrupt:
            return mark_interrupted(outcome)
        if _has_failed(finer.raw):
            break
        outcome = _fix_stationary_joints(run, finer)
    if outcome.raw.converged and not _excess_by_limit(outcome.assessment):
        return _remove_excess_between_nodes(run, outcome)
    return outcome


def backed_off(margin: float, excess: float) -> float:
    """Return the relative back-off of a limit after a motion has exceeded it by a share.

    The bound is divided by the relative excess: it stays above zero however often it is backed off.
    """
    return 1.0 - (1.0 - margin) / (1.0 + excess)


def _fix_stationary_joints(run: SolveRun, outcome: Outcome) -> Outcome:
    """Return the outcome with joints at rest where that improves it.

    First joints may creep where that costs less than moving; where they do, they are fixed.
    """
    free = standing = outcome.transcription
    if not run.problem.charges_dry_friction or free.ocp.phases > _MAX_STATIONARY_PHASES:
        return outcome
    step, run.step = run.step, "joints at rest"
    best = found = outcome
    smoothing = replace(outcome.smoothing, creeping=1.0)
    made = Programme(free, outcome.solver)
    for attempt in range(_MAX_STATIONARY_SOLVES + 1):
        limit = None if attempt else _MAX_CREEPING_ITERATIONS
        try:
            raw = solve_correction(run, made, found.raw, standing.nlp, smoothing, limit)
            found = certify_outcome(run, made, raw, smoothing)
        except KeyboardInterrupt:
            best = mark_interrupted(best)
            break
        if raw.converged and rank_outcome(run.problem, found) < rank_outcome(run.problem, best):
            best = replace(found, transcription=standing)
        # A motion that still changes shows where joints creep as well.
        fixed = fix_creeping_joints(free, raw.x, run.problem)
        if raw.status == "interrupted":
            best = mark_interrupted(best)
            break
        if fixed is None or not (raw.converged or attempt == 0):
            break
        standing = fixed
    run.step = step
    best.solver.set_bounds(best.transcription.nlp)
    return best


def _remove_excess_between_nodes(run: SolveRun, outcome: Outcome) -> Outcome:
    """Return the outcome with the objective gap between nodes removed, where that improves it."""
    inside, _ = _back_off_rows(run, outcome, outcome.transcription.nlp)
    if inside.raw.status == "interrupted":
        outcome = mark_interrupted(outcome)
    elif inside.raw.converged and rank_outcome(run.problem, inside) <= rank_outcome(
        run.problem, outcome
    ):
        return inside
    # Restore the bounds that it was solved with.
    outcome.solver.set_bounds(outcome.transcription.nlp)
    return outcome


def rank_outcome(problem: TrajectoryProblem, outcome: Outcome) -> tuple[bool, float]:
    """Return the sort key of outcomes: certified ones first, then the certified objective."""
    value = objective_value(problem, outcome.assessment).value
    feasible = outcome.assessment.feasible(CERTIFICATE_TOLERANCE)
    return not feasible, -value if is_maximised(problem) else value


def refine_within_mesh(run: SolveRun, outcome: Outcome, nlp: Nlp) -> Outcome:
    """Back off rows on the same mesh where the exact ones, or the simulated arm, exceed them.

    For a motion planned for the links; `nlp` is its programme with the bounds so far.
    """
    outcome, nlp = _back_off_rows(run, outcome, nlp)
    # With the sum of the simulated tool deviations, in flight and after arrival.
    best = (np.inf, outcome, nlp)
    for again in range(_MAX_REFINEMENTS + 1):
        found, arm = _suppress_vibration(run, outcome)
        late = _arrival_overshoot(run.problem, found.assessment)
        reach, off = (np.inf, 0.0) if late or arm is None else (arm.reach, arm.off)
        if reach <= best[0]:
            best = reach, found, nlp
        asked = _requested_back_off(run, outcome, nlp, late, off, again)
        if again == _MAX_REFINEMENTS or reach > best[0] or not (asked and found.raw.converged):
            break
        closer = back_off_uniformly(nlp, asked)
        if not _allows_other_motion(closer, nlp, moved=False):
            break
        try:
            other = solve_again(run, outcome, closer, outcome.smoothing)
        except KeyboardInterrupt:
            return mark_interrupted(best[1])
        if _has_failed(other.raw):
            break
        outcome, nlp = _back_off_rows(run, other, closer)
    _, found, nlp = best
    found.solver.set_bounds(nlp)
    return found


def _requested_back_off(
    run: SolveRun, outcome: Outcome, nlp: Nlp, late: dict[str, float], off: float, again: int
) -> dict[str, float]:
    """Return the back-off by limit for an arm that is `off` from its plan; empty if it is near.

    `late` are the limits that it exceeds after arrival.
    """
    wide = outcome.smoothing.lead > 1.0
    if any(block.rows.name in late for block in nlp.rows.items):
        # The rows overestimate the arm's vibration, so that back-off acts slowly. They do not model
        # the residual vibration of a wide smoothing at all.
        return {} if wide else {name: excess * 2.0**again for name, excess in late.items()}
    if late:
        # The plan ends at rest, the arm does not: vibration suppression lacks drive reserve.
        return {"jerk": _JERK_RESERVE} if again else dict.fromkeys(_DRIVE_LIMITS, _DRIVE_RESERVE)
    swings = any(each.kind.plans_links for each in run.problem.objectives)
    if swings and wide and off > _MAX_PLAN_DEVIATION:
        return {"jerk": _JERK_RESERVE}
    return {}


def _back_off_rows(run: SolveRun, outcome: Outcome, nlp: Nlp) -> tuple[Outcome, Nlp]:
    """Back off path rows until the exact ones hold; return the programme with their bounds too.

    While the exact rows themselves show an excess, the certificate is not evaluated. The motor
    law's smoothing is widened where an excess remains.
    """
    made = Programme(outcome.transcription, outcome.solver)
    rows, smoothing, raw = None, outcome.smoothing, outcome.raw
    known: Excess | None = None
    unseen: dict[str, float] = {}
    try:
        for attempt in range(1, _MAX_CORRECTIONS + 1):
            if rows is None or known is None:
                excess = _excess_by_limit(outcome.assessment)
                worst = max(excess.values(), default=0.0)
                if not _needs_correction(outcome, excess):
                    break
                # A large excess that a correction has not removed comes from a kink.
                if worst > (KINK_EXCESS if attempt > 1 else _SPIKE_EXCESS):
                    smoothing = replace(smoothing, lead=_widen_motor_smoothing(run, outcome))
                rows = rows or PointFunction(exact_path_rows(run.problem, run.motion, run.scales))
                bends = _CHECK_SMOOTHING_SHARE if outcome.objective_gap > MAX_OBJECTIVE_GAP else 1.0
                bent = smoothing.narrowed(bends).parameters
                found = _known_drive_rows(run.problem, outcome.assessment)
                known = path_row_excess(made.transcription, raw.x, bent, rows, found)
                unseen = _unexplained_excess(known, excess)
            given = made.transcription.nlp
            closer = back_off_exceeded(nlp, known, given, most=_MAX_BACK_OFF_STEP, limits=LIMITS)
            closer = back_off_uniformly(closer, unseen)
            if not _allows_other_motion(closer, nlp, moved=smoothing != outcome.smoothing):
                break
            nlp = closer
            again = solve_correction(run, made, raw, nlp, smoothing)
            if _has_failed(again):
                break
            raw, known = again, None
            if raw.converged and not unseen:
                left = path_row_excess(made.transcription, raw.x, smoothing.parameters, rows)
                known = left if _is_conclusive(left) else None
            if known is None:
                outcome = certify_outcome(run, made, raw, smoothing)
        if outcome.raw is not raw:
            outcome = certify_outcome(run, made, raw, smoothing)
    except KeyboardInterrupt:
        if outcome.raw is not raw:
            outcome = certify_outcome(run, made, raw, smoothing)
        outcome = mark_interrupted(outcome)
    return outcome, nlp


def _widen_motor_smoothing(run: SolveRun, outcome: Outcome) -> float:
    """Return a wider smoothing of the motor law for which the same links exceed limits by little.

    The present one where a wider one lowers no excess, which then is not due to a kink.
    """
    corners = outcome.smoothing.lead

    @functools.cache
    def beyond(width: float) -> float:
        motors = motors_with_law(run, outcome, width / corners, sagged=False)
        return max(v.value for v in drive_violations(run.problem, motors))

    found = narrowest_sufficient_width(beyond, 2.0 * corners, TOLERABLE_KINK_EXCESS)
    return found if beyond(found) <= MAX_REMAINING_EXCESS * beyond(corners) else corners


def _known_drive_rows(problem: TrajectoryProblem, motion: Assessment) -> dict[str, KnownRows]:
    """Return the certified drive quantities over their limits, by name of the limit.

    Not of torques with dry friction, whose rows bound both directions of friction.
    """
    if not problem.plans_links:
        return {}
    names = [
        name for name in _DRIVE_LIMITS if name != "torque" or not np.any(problem.robot.coulomb)
    ]
    found = {}
    for name in names:
        limit = np.broadcast_to(getattr(problem.active_limits, name), (problem.joints,))
        bounded = np.isfinite(limit)
        found[name] = KnownRows(motion.time, getattr(motion, name)[:, bounded] / limit[bounded])
    return found


def _needs_correction(outcome: Outcome, excess: dict[str, float]) -> bool:
    return outcome.raw.converged and (bool(excess) or outcome.objective_gap > MAX_OBJECTIVE_GAP)


def _unexplained_excess(known: Excess, excess: dict[str, float]) -> dict[str, float]:
    """Return excesses that the rows do not show, such as the delay by damping."""
    unseen = {
        k: v for k, v in excess.items() if known.largest.get(k, 0.0) < _MIN_EXPLAINED_SHARE * v
    }
    return {k: min(v, _MAX_BACK_OFF_STEP) for k, v in unseen.items()}


def _allows_other_motion(nlp: Nlp, before: Nlp, *, moved: bool) -> bool:
    """Return True where bounds or smoothing (`moved`) changed and the bounds are consistent."""
    asks = moved or not _same_bounds(nlp, before)
    return asks and bool(np.all(nlp.lower_g <= nlp.upper_g))


def _same_bounds(one: Nlp, other: Nlp) -> bool:
    return np.array_equal(one.lower_g, other.lower_g) and np.array_equal(one.upper_g, other.upper_g)


def _is_conclusive(excess: Excess) -> bool:
    """Return True where limits are clearly exceeded, and not because of a kink of the motor law."""
    worst = max((v for name, v in excess.largest.items() if name in LIMITS), default=0.0)
    return 2.0 * _TARGET_EXCESS < worst <= KINK_EXCESS


def mark_interrupted(outcome: Outcome) -> Outcome:
    """Return the outcome with the status "interrupted"."""
    return replace(outcome, raw=replace(outcome.raw, status="interrupted", reason="Ctrl-C"))


def _is_worse_than(problem: TrajectoryProblem, outcome: Outcome, rival: Baseline | None) -> bool:
    if rival is None or rival.objective is None:
        return False
    value = objective_value(problem, outcome.assessment).value
    ratio = improvement(problem, value, rival.objective)
    return ratio is not None and ratio > 1.0


def _sharpen_motor_law(run: SolveRun, outcome: Outcome) -> Outcome:
    """Return the same links with the sharpest motor law for which every limit holds.

    Residual vibration from smoothing decreases with its width; that from the links' sag vanishes
    for motors computed at the sagged position. The optimiser's rows model neither.
    """
    # With free arrival the motors are at rest only by the law that was solved.
    if _worst_flight_violation(outcome.assessment) > CERTIFICATE_TOLERANCE or run.end_modes:
        return outcome
    found, share = outcome, 1.0
    # A narrower law needs more of the motors: bisection finds the narrowest feasible one.
    first, last = 0, len(_SHARPER_LAW_SHARES)
    while first < last:
        middle = (first + last) // 2
        tried = _replace_motors(run, outcome, _SHARPER_LAW_SHARES[middle], sagged=False)
        if tried is None:
            first = middle + 1
        else:
            found, share, last = tried, _SHARPER_LAW_SHARES[middle], middle
    return _replace_motors(run, outcome, share, sagged=True) or found


def _suppress_vibration(run: SolveRun, outcome: Outcome) -> tuple[Outcome, SimulatedMotors | None]:
    """Return the same links with the least vibration: by a sharper law, then by a motor change.

    The latter where every limit holds in flight. With the simulated arm, where it was simulated.
    """
    if not outcome.raw.converged:
        return outcome, None
    outcome = _sharpen_motor_law(run, outcome)
    if run.lag is None or _worst_flight_violation(outcome.assessment) > CERTIFICATE_TOLERANCE:
        return outcome, None
    try:
        arm = run.arm.with_fast_joints_following(run.motion.start)
        found = suppress_vibration(run.problem, arm, outcome.trajectory, CERTIFICATE_TOLERANCE)
    except NotSimulatedError:
        return outcome, None
    except KeyboardInterrupt:
        return mark_interrupted(outcome), None
    return replace(outcome, trajectory=found.motors, assessment=found.assessment), found


def _replace_motors(
    run: SolveRun, outcome: Outcome, share: float, *, sagged: bool
) -> Outcome | None:
    """Return the outcome with recomputed motors, None where they exceed a limit in flight."""
    trajectory = motors_with_law(run, outcome, share, sagged=sagged)
    if drive_violations(run.problem, trajectory)[0].value > CERTIFICATE_TOLERANCE:
        return None
    assessment = assess(run.problem, trajectory)
    if _worst_flight_violation(assessment) > CERTIFICATE_TOLERANCE:
        return None
    return replace(outcome, trajectory=trajectory, assessment=assessment)


def _has_failed(raw: RawSolution) -> bool:
    return not raw.converged and raw.status not in ("interrupted", "time_limit")


def _excess_by_limit(assessment: Assessment) -> dict[str, float]:
    """Return excesses above the target by row name; start and end cannot be backed off."""
    fixed = ("start", "end")
    return {
        v.limit.replace("via_", "via "): v.value
        for v in assessment.violations
        if v.value > _TARGET_EXCESS and not v.limit.startswith(fixed) and not _concerns_arrival(v)
    }


def _worst_flight_violation(assessment: Assessment) -> float:
    return max(
        (v.value for v in assessment.violations if not _concerns_arrival(v)), default=-np.inf
    )


def _arrival_overshoot(problem: TrajectoryProblem, assessment: Assessment) -> dict[str, float]:
    """Return the limits that the arm exceeds after arrival, with the relative overshoot."""
    exceeded = {
        v.limit for v in assessment.violations if _concerns_arrival(v) and v.value > _TARGET_EXCESS
    }
    limits = problem.active_limits
    if assessment.simulated is None or assessment.simulated.peak_after is None:
        return {}
    return {name: LIMITS[name].overshoot(limits, assessment.simulated) for name in exceeded}


def _concerns_arrival(violation: Violation) -> bool:
    kind = LIMITS.get(violation.limit)
    return kind is not None and kind.of_arrival
