"""What is done where the certificate finds more than a limit allows: refine, tighten, solve again.

A motion that joints and links share is solved on a finer mesh, then with its limits tightened. A
motion planned for the links keeps its mesh, which long chains of integrators take badly anew: each
row is drawn in where the exact one exceeds it. Both up to a few times.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from stiffopt.certificate.assess import assess, drive_violations
from stiffopt.certificate.objective_value import improvement, is_maximised, objective_value
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.errors import NotSimulatedError
from stiffopt.problem.formulation import exact_path_rows
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.result.solution import Baseline
from stiffopt.solver.calming import Calmed, calmed
from stiffopt.solver.corners import CORNERS_TAKE, HELPS, narrowest
from stiffopt.solver.ipopt import RawSolution
from stiffopt.solver.plan import SolveStage
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stages import (
    Outcome,
    Programme,
    corrected,
    finer_mesh,
    motors_of,
    outcome_of,
    run_stages,
    solve_again,
)
from stiffopt.solver.standstill import at_rest
from stiffopt.solver.verdict import TRUE_OBJECTIVE
from stiffopt.transcription.constraint_back_off import (
    Excess,
    KnownRows,
    back_off_exceeded,
    back_off_uniformly,
    path_row_excess,
)
from stiffopt.transcription.nlp import Nlp
from stiffopt.transcription.point_function import PointFunction

# Motions are tightened until the excess is below this, so that the certificate's tolerance is never
# only just met.
_AIM = 0.8 * CERTIFIED
# Gap of the objective between nodes that a finer mesh is worth, where a baseline is better.
_CLOSE = 1e-3
_REFINEMENTS = 3
# Gap of the objective from which on joints that creep are brought to rest, so often at most.
_CREEP, _STANDS = 5e-3, 2
_GROWTH = 1.25
_CORRECTIONS = 12
# Of a row's bound at once: a larger excess is a narrow one, and goes with less.
_LARGEST_STEP = 0.15
# Share of an excess that the exact rows have to show where it is theirs.
_SEEN = 0.5
# Shares of these limits that are left to motors which have to calm their links, at first.
_OF_DRIVES, _ROOM = ("velocity", "acceleration", "jerk", "torque"), 0.04
# And of the jerk, which corners of the stiffness take most of, each time after.
_ROOM_OF_JERK = 0.15
# How far an arm may be from its plan, in flight and after arrival, over the plan's peak.
_OFF = 5e-2
# Of the widths of the joints' stiffness, by which exact rows are looked at where the objective is
# worse than believed: what is passed over a bend of it shows.
_BENDS = 0.1
# Of the widths of the motors' law, tried when all limits hold: at half of it, nothing more is left
# after arrival than by the exact law.
_SHARPER = (0.5, 0.6, 0.7, 0.8, 0.9)
# An excess that is still larger after a correction is a corner of a joint's stiffness passed too
# fast: the motors' law gets wider corners.
_CORNER = 0.25
# Beyond what any correction takes: the corners get wider before the first.
_SPIKE = 4.0


def refined(run: SolveRun, outcome: Outcome, rival: Baseline | None) -> Outcome:
    """The outcome refined until the certificate finds no more than it allows.

    Also where only between the nodes a feasible baseline, the `rival`, is better.
    """
    if run.problem.plans_links:
        return refined_within(run, outcome, outcome.transcription.nlp)
    return _on_finer_mesh(run, outcome, rival)


def _on_finer_mesh(run: SolveRun, outcome: Outcome, rival: Baseline | None) -> Outcome:
    """A finer mesh, short where the controls change; from the second time on tighter limits."""
    margins: dict[str, float] = {}
    outcome = _standing(run, outcome)
    for attempt in range(1, _REFINEMENTS + 1):
        excess = _excess(outcome.assessment)
        true = _CLOSE if _is_behind(run.problem, outcome, rival) else TRUE_OBJECTIVE
        if not outcome.raw.converged or not (excess or outcome.objective_gap > true):
            break
        if attempt > 1 and run.problem.path is not None:
            # All limits are path rows: they are drawn in where they are exceeded, and only there.
            return _within_rows(run, outcome, outcome.transcription.nlp)[0]
        if attempt > 1:
            for name, value in excess.items():
                margins[name] = backed_off(margins.get(name, 0.0), value)
        before = outcome.transcription
        intervals = int(np.ceil(len(before.intervals) * _GROWTH))
        guess = before.guess_from(outcome.raw.x)
        mesh = finer_mesh(run.problem, before, outcome.raw.x, intervals)
        stage = SolveStage(intervals, outcome.smoothing)
        try:
            finer = run_stages(run, (stage,), guess, margins, mesh)
        except KeyboardInterrupt:
            return stopped(outcome)
        if _failed(finer.raw):
            break
        outcome = _standing(run, finer)
    if outcome.raw.converged and not _excess(outcome.assessment):
        return _without_bulges(run, outcome)
    return outcome


def backed_off(margin: float, excess: float) -> float:
    """Share by which a limit is tightened after a motion has exceeded it by a share.

    The bound is divided by what exceeded it: however often, it stays above 0.
    """
    return 1.0 - (1.0 - margin) / (1.0 + excess)


def _standing(run: SolveRun, outcome: Outcome) -> Outcome:
    """The outcome with joints that creep at rest, as far as that makes it better."""
    free = outcome.transcription
    if not any(objective.kind.of_drives for objective in run.problem.objectives):
        return outcome
    for _ in range(_STANDS):
        if not outcome.raw.converged or outcome.objective_gap <= _CREEP:
            break
        standing = at_rest(free, outcome.raw.x, run.problem)
        if standing is None:
            break
        try:
            found = solve_again(run, outcome, standing.nlp, outcome.smoothing)
        except KeyboardInterrupt:
            return stopped(outcome)
        if not found.raw.converged or rank(run.problem, found) >= rank(run.problem, outcome):
            outcome.solver.rebound(outcome.transcription.nlp)
            return stopped(outcome) if found.raw.status == "interrupted" else outcome
        outcome = replace(found, transcription=standing)
    return outcome


def _without_bulges(run: SolveRun, outcome: Outcome) -> Outcome:
    """The outcome without what bulges between two nodes of any mesh, where that makes it better."""
    inside, _ = _within_rows(run, outcome, outcome.transcription.nlp)
    if inside.raw.status == "interrupted":
        outcome = stopped(outcome)
    elif inside.raw.converged and rank(run.problem, inside) <= rank(run.problem, outcome):
        return inside
    # Its bounds are those that it was solved with.
    outcome.solver.rebound(outcome.transcription.nlp)
    return outcome


def rank(problem: TrajectoryProblem, outcome: Outcome) -> tuple[bool, float]:
    """What outcomes are ordered by: certified ones first, then by their certified objective."""
    value = objective_value(problem, outcome.assessment).value
    feasible = outcome.assessment.feasible(CERTIFIED)
    return not feasible, -value if is_maximised(problem) else value


def refined_within(run: SolveRun, outcome: Outcome, nlp: Nlp) -> Outcome:
    """The same mesh, rows drawn in where the exact ones, or the simulated arm, exceed them.

    For a motion that is planned for the links; `nlp` is its programme with the bounds so far.
    """
    outcome, nlp = _within_rows(run, outcome, nlp)
    # With how far its tool goes on the simulated arm, in flight and after arrival.
    best = (np.inf, outcome, nlp)
    for again in range(_REFINEMENTS + 1):
        found, arm = _calmed(run, outcome)
        late = _after_arrival(run.problem, found.assessment)
        reach, off = (np.inf, 0.0) if late or arm is None else (arm.reach, arm.off)
        if reach <= best[0]:
            best = reach, found, nlp
        asked = _asked_of(run, outcome, nlp, late, off, again)
        if again == _REFINEMENTS or reach > best[0] or not (asked and found.raw.converged):
            break
        closer = back_off_uniformly(nlp, asked)
        if not _worth_solving(closer, nlp, moved=False):
            break
        try:
            other = solve_again(run, outcome, closer, outcome.smoothing)
        except KeyboardInterrupt:
            return stopped(best[1])
        if _failed(other.raw):
            break
        outcome, nlp = _within_rows(run, other, closer)
    _, found, nlp = best
    found.solver.rebound(nlp)
    return found


def _asked_of(
    run: SolveRun, outcome: Outcome, nlp: Nlp, late: dict[str, float], off: float, again: int
) -> dict[str, float]:
    """By how much rows are to be drawn in as the arm is `off` from its plan; none if it is near.

    `late` are the limits that it exceeds after arrival.
    """
    wide = outcome.smoothing.corners > 1.0
    if any(block.rows.name in late for block in nlp.rows.items):
        # The size that rows know is more than the arm's: it gives way slowly. What wide corners
        # leave they do not know at all.
        return {} if wide else {name: excess * 2.0**again for name, excess in late.items()}
    if late:
        # The plan is at rest, the arm is not: its motors lack the room to calm it.
        return {"jerk": _ROOM_OF_JERK} if again else dict.fromkeys(_OF_DRIVES, _ROOM)
    swings = any(each.kind.plans_links for each in run.problem.objectives)
    if swings and wide and off > _OFF:
        return {"jerk": _ROOM_OF_JERK}
    return {}


def _within_rows(run: SolveRun, outcome: Outcome, nlp: Nlp) -> tuple[Outcome, Nlp]:
    """Path rows drawn in until the exact ones are kept; the programme with their bounds.

    While the exact rows themselves show an excess, nothing else is asked of the motion. Corners of
    the motors' law get wider where an excess stays.
    """
    made = Programme(outcome.transcription, outcome.solver)
    rows, smoothing, raw = None, outcome.smoothing, outcome.raw
    known: Excess | None = None
    unseen: dict[str, float] = {}
    try:
        for attempt in range(1, _CORRECTIONS + 1):
            if rows is None or known is None:
                excess = _excess(outcome.assessment)
                worst = max(excess.values(), default=0.0)
                if not _to_mend(outcome, excess):
                    break
                if worst > (_CORNER if attempt > 1 else _SPIKE):
                    smoothing = replace(smoothing, corners=_passable(run, outcome))
                rows = rows or PointFunction(exact_path_rows(run.problem, run.motion, run.scales))
                bends = _BENDS if outcome.objective_gap > TRUE_OBJECTIVE else 1.0
                bent = smoothing.bent(bends).parameters
                found = _driven(run.problem, outcome.assessment)
                known = path_row_excess(made.transcription, raw.x, bent, rows, found)
                unseen = _unseen(known, excess)
            given = made.transcription.nlp
            closer = back_off_exceeded(nlp, known, given, most=_LARGEST_STEP, limits=LIMITS)
            closer = back_off_uniformly(closer, unseen)
            if not _worth_solving(closer, nlp, moved=smoothing != outcome.smoothing):
                break
            nlp = closer
            again = corrected(run, made, raw, nlp, smoothing)
            if _failed(again):
                break
            raw, known = again, None
            if raw.converged and not unseen:
                left = path_row_excess(made.transcription, raw.x, smoothing.parameters, rows)
                known = left if _speaks_for_itself(left) else None
            if known is None:
                outcome = outcome_of(run, made, raw, smoothing)
        if outcome.raw is not raw:
            outcome = outcome_of(run, made, raw, smoothing)
    except KeyboardInterrupt:
        if outcome.raw is not raw:
            outcome = outcome_of(run, made, raw, smoothing)
        outcome = stopped(outcome)
    return outcome, nlp


def _passable(run: SolveRun, outcome: Outcome) -> float:
    """Wider corners of the motors' law, by which the same links exceed limits by little.

    As wide as they are where that lowers no excess: then it is none of a corner.
    """
    corners = outcome.smoothing.corners

    @functools.cache
    def beyond(width: float) -> float:
        motors = motors_of(run, outcome, width / corners, sagged=False)
        return max(v.value for v in drive_violations(run.problem, motors))

    found = narrowest(beyond, 2.0 * corners, CORNERS_TAKE)
    return found if beyond(found) <= HELPS * beyond(corners) else corners


def _driven(problem: TrajectoryProblem, motion: Assessment) -> dict[str, KnownRows]:
    """What the drives do in truth, over their limits; by name of the limit.

    Of torques with dry friction rows are either side's envelope, which they are enough for.
    """
    if not problem.plans_links:
        return {}
    names = [name for name in _OF_DRIVES if name != "torque" or not np.any(problem.robot.coulomb)]
    found = {}
    for name in names:
        limit = np.broadcast_to(getattr(problem.active_limits, name), (problem.joints,))
        bounded = np.isfinite(limit)
        found[name] = KnownRows(motion.time, getattr(motion, name)[:, bounded] / limit[bounded])
    return found


def _to_mend(outcome: Outcome, excess: dict[str, float]) -> bool:
    return outcome.raw.converged and (bool(excess) or outcome.objective_gap > TRUE_OBJECTIVE)


def _unseen(known: Excess, excess: dict[str, float]) -> dict[str, float]:
    """What the rows do not know, such as the delay by damping: it is the same all along."""
    unseen = {k: v for k, v in excess.items() if known.largest.get(k, 0.0) < _SEEN * v}
    return {k: min(v, _LARGEST_STEP) for k, v in unseen.items()}


def _worth_solving(nlp: Nlp, before: Nlp, *, moved: bool) -> bool:
    """Whether rows, or `moved` corners, ask for another motion and leave room for one."""
    asks = moved or not _same_bounds(nlp, before)
    return asks and bool(np.all(nlp.lower_g <= nlp.upper_g))


def _same_bounds(one: Nlp, other: Nlp) -> bool:
    return np.array_equal(one.lower_g, other.lower_g) and np.array_equal(one.upper_g, other.upper_g)


def _speaks_for_itself(excess: Excess) -> bool:
    """Whether limits are exceeded for certain, and by no corner of the motors' law."""
    worst = max((v for name, v in excess.largest.items() if name in LIMITS), default=0.0)
    return 2.0 * _AIM < worst <= _CORNER


def stopped(outcome: Outcome) -> Outcome:
    """An outcome that Ctrl-C made the last."""
    return replace(outcome, raw=replace(outcome.raw, status="interrupted", reason="Ctrl-C"))


def _is_behind(problem: TrajectoryProblem, outcome: Outcome, rival: Baseline | None) -> bool:
    if rival is None or rival.objective is None:
        return False
    value = objective_value(problem, outcome.assessment).value
    ratio = improvement(problem, value, rival.objective)
    return ratio is not None and ratio > 1.0


def _sharpened(run: SolveRun, outcome: Outcome) -> Outcome:
    """The same links with motors by a law nearer to the true one, as far as every limit holds.

    What the wider law leaves after arrival goes with its width; what is left as the links move with
    their sag goes where springs carry them as they hang. Rows of the optimiser know neither.
    """
    # Motors whose links swing on are at rest by the law they were solved with.
    if _worst_in_flight(outcome.assessment) > CERTIFIED or run.end_modes:
        return outcome
    found, share = outcome, 1.0
    # A narrower law asks for more: halving finds the narrowest that does.
    first, last = 0, len(_SHARPER)
    while first < last:
        middle = (first + last) // 2
        tried = _with_motors(run, outcome, _SHARPER[middle], sagged=False)
        if tried is None:
            first = middle + 1
        else:
            found, share, last = tried, _SHARPER[middle], middle
    return _with_motors(run, outcome, share, sagged=True) or found


def _calmed(run: SolveRun, outcome: Outcome) -> tuple[Outcome, Calmed | None]:
    """The same links with motors that let them swing least: by a sharper law, then as they answer.

    The second where every limit holds in flight, and the arm is off from its plan: by wide corners
    of the law, or as its links sag. With what the arm does, where it was simulated.
    """
    if not outcome.raw.converged:
        return outcome, None
    outcome = _sharpened(run, outcome)
    if run.lag is None or _worst_in_flight(outcome.assessment) > CERTIFIED:
        return outcome, None
    try:
        arm = run.arm.with_fast_joints_following(run.motion.start)
        found = calmed(run.problem, arm, outcome.trajectory, CERTIFIED)
    except NotSimulatedError:
        return outcome, None
    except KeyboardInterrupt:
        return stopped(outcome), None
    return replace(outcome, trajectory=found.motors, assessment=found.assessment), found


def _with_motors(run: SolveRun, outcome: Outcome, share: float, *, sagged: bool) -> Outcome | None:
    """The outcome with motors of its own, where they keep every limit in flight."""
    trajectory = motors_of(run, outcome, share, sagged=sagged)
    if drive_violations(run.problem, trajectory)[0].value > CERTIFIED:
        return None
    assessment = assess(run.problem, trajectory)
    if _worst_in_flight(assessment) > CERTIFIED:
        return None
    return replace(outcome, trajectory=trajectory, assessment=assessment)


def _failed(raw: RawSolution) -> bool:
    return not raw.converged and raw.status not in ("interrupted", "time_limit")


def _excess(assessment: Assessment) -> dict[str, float]:
    """Rows exceeded by more than the aim, by their names; start and end cannot be tightened."""
    fixed = ("start", "end")
    return {
        v.limit.replace("via_", "via "): v.value
        for v in assessment.violations
        if v.value > _AIM and not v.limit.startswith(fixed) and not _of_arrival(v)
    }


def _worst_in_flight(assessment: Assessment) -> float:
    return max((v.value for v in assessment.violations if not _of_arrival(v)), default=-np.inf)


def _after_arrival(problem: TrajectoryProblem, assessment: Assessment) -> dict[str, float]:
    """Limits that the arm exceeds after arrival, by what its size is above the allowed one."""
    exceeded = {v.limit for v in assessment.violations if _of_arrival(v) and v.value > _AIM}
    limits = problem.active_limits
    if assessment.swing is None or assessment.swing.peak_after is None:
        return {}
    return {name: LIMITS[name].overshoot(limits, assessment.swing) for name in exceeded}


def _of_arrival(violation: Violation) -> bool:
    kind = LIMITS.get(violation.limit)
    return kind is not None and kind.of_arrival
