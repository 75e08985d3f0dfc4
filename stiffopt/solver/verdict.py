"""Verdict on a solve: status and message, from the solver, the certificate and the baselines.

A motion is optimal only if it keeps all limits on the fine grid, if the optimiser's prediction of
it agrees with the exact model, and if no baseline that keeps all limits is better.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.baseline.baselines import better_baseline
from stiffopt.certificate.agreement import Disagreement, find_disagreements
from stiffopt.certificate.assess import assess
from stiffopt.certificate.collisions import COLLISION_LIMIT, describe_collision_scope
from stiffopt.certificate.objective_value import is_maximised, objective_value
from stiffopt.certificate.violations import (
    CERTIFICATE_TOLERANCE,
    DRIVE_LIMITS,
    describe_slips,
    find_slips,
)
from stiffopt.command.compensation import requests_command
from stiffopt.problem.formulation import smoothing_stages
from stiffopt.problem.prediction import predict_motion
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import Baseline
from stiffopt.result.status import SolveStatus
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.monitor import FEASIBLE_VIOLATION
from stiffopt.transcription.nlp import NlpEntry, RowViolation

if TYPE_CHECKING:
    from stiffopt.solver.programme import Outcome

# Relative excess of the objective on the fine grid over that at the nodes, above which a motion is
# refined and not called optimal.
MAX_OBJECTIVE_GAP = 2e-2
# Difference of a wind-up or deflection that no fit of a contact law explains: "power_law" misses
# the fractal law by up to 5 %.
_WRONG_MODEL_DIFFERENCE = 6e-2
# Share of the objective gap from which on missing friction is reported as its cause.
_MIN_FRICTION_SHARE = 0.5
# Ratio of every baseline's deflection to its limit from which on the limit is reported as out of
# reach: no known optimum is so far below its baselines.
_OUT_OF_REACH_RATIO = 10.0
# Bounds of states and controls are limits of the joints: "control rate, acceleration of joint 1 (at
# 50 %)" is the limit of the jerk.
_BOUND_ENTRY = re.compile(r"(state|control|control rate|\w+ within interval), (\w+) of (joint .*)")
# Blocks of the programme that hold the motion: fixed values in them are those of start and end.
_MOTION_BLOCKS = ("state", "control", "control at the start", "spline")
_DERIVATIVE_NAMES = {"velocity": "acceleration", "acceleration": "jerk"}


@dataclass(frozen=True)
class Verdict:
    """Status of a solve and its message."""

    status: SolveStatus
    message: str


def judge_outcome(
    problem: TrajectoryProblem,
    outcome: Outcome,
    motion: Assessment,
    compared: dict[str, Baseline],
    corrections: Sequence[Mapping[str, Any]] = (),
) -> Verdict:
    """Judge an outcome by solver, certificate, model agreement and baselines.

    `motion` is its assessment with collisions, which `judge_collisions` judges; `corrections` are
    the solves after the first one, as recorded.
    """
    own = Verdict(_solve_status(outcome), _status_message(problem, outcome, motion, corrections))
    found = _judge_model_agreement(problem, outcome, motion, own)
    if not motion.feasible(CERTIFICATE_TOLERANCE) and (
        beyond := _explain_unreachable_deflection(problem, compared)
    ):
        # Known before the solve: however its time ended, more of it does not help.
        conflict = outcome.raw.conflicts or outcome.raw.worst_rows
        listed = f" These conflict: {named_conflicts(conflict)}." if conflict else ""
        found = Verdict(SolveStatus.INFEASIBLE, f"{beyond}{listed}")
    better = find_better_baseline(problem, outcome, compared)
    if better is None or found.status is SolveStatus.INFEASIBLE:
        return found
    told = f"{found.message} But the {better.name} motion"
    more = "raise method.intervals or method.starts."
    if not outcome.assessment.feasible(CERTIFICATE_TOLERANCE):
        return Verdict(found.status, f"{told} keeps all limits: run that one, or {more}")
    # A motion of least tool error was chosen beside the rivals, phase by phase, and is judged with
    # their commands.
    if problem.judges_uncertain_arms:
        return found
    if problem.leads_when_fastest:
        told = f"The {better.name} motion is faster, but its motors do not lead the links."
        return Verdict(found.status, f"{found.message} {told}")
    optimal = found.status is SolveStatus.OPTIMAL
    # Where commands are made, these say which motion to run.
    run = "" if requests_command(problem) else "run that one, or "
    return Verdict(
        SolveStatus.ACCEPTABLE if optimal else found.status,
        f"{told} has a better objective and keeps all limits as well: {run}{more}",
    )


def _explain_unreachable_deflection(
    problem: TrajectoryProblem, compared: dict[str, Baseline]
) -> str:
    """Return why a limit on the dynamic deflection is out of reach, "" where it may be met."""
    cap = float(problem.active_limits.dynamic_deflection)
    peaks = {
        name: (float(np.linalg.norm(motion.deflection["dynamic"], axis=1).max()), motion.time[-1])
        for name, baseline in compared.items()
        if (motion := baseline.assessment) is not None
    }
    if not peaks or not math.isfinite(cap):
        return ""
    name = min(peaks, key=lambda each: peaks[each][0])
    peak, lasted = peaks[name]
    if peak < _OUT_OF_REACH_RATIO * cap:
        return ""
    return (
        f"limits.dynamic_deflection = {1e3 * cap:.3g} mm is out of reach: the acceleration torques"
        f" deflect the tool by {1e3 * peak:.3g} mm in the {name} motion of {lasted:.3g} s. The"
        " deflection falls with the square of the duration: allow about"
        f" {lasted * math.sqrt(peak / cap):.2g} s, or raise the limit; more time to solve does not"
        " help."
    )


def judge_collisions(
    problem: TrajectoryProblem, motion: Assessment, found: Verdict, tried: str = ""
) -> Verdict:
    """Return the verdict of a motion that may collide; a usable one states the collision scope.

    `motion` has the rows of its collisions; `tried` are failed attempts to avoid them.
    """
    exceeded = [v for v in motion.violations if v.value > CERTIFICATE_TOLERANCE]
    hits = [v for v in exceeded if v.limit == COLLISION_LIMIT]
    listed = "; ".join(hit.describe() for hit in hits[:3])
    if hits and found.status.usable:
        told = f"{listed}. {tried}".strip()
        return Verdict(
            SolveStatus.CERTIFICATE_FAILED,
            f"Every other limit holds on the fine grid, but the motion does not keep {told} "
            "Do not run it; add a motion.via beside the obstacle, or change its start or end.",
        )
    if hits and found.status is not SolveStatus.INFEASIBLE:
        word = "And" if len(exceeded) > len(hits) else "But"
        text = f"{found.message} {word} it does not keep {listed}: do not run it."
        return Verdict(found.status, text)
    if not found.status.usable:
        return found
    return Verdict(found.status, f"{found.message} {describe_collision_scope(problem)}".strip())


def _judge_model_agreement(
    problem: TrajectoryProblem, outcome: Outcome, motion: Assessment, found: Verdict
) -> Verdict:
    """Return the verdict, downgraded where the optimiser's prediction is wrong."""
    doubts = _significant_disagreements(problem, outcome) if outcome.raw.converged else []
    if not doubts:
        return found
    listed = "; ".join(d.describe() for d in doubts[:3])
    slipping = find_slips(problem.robot, motion)
    if slipping and any(np.isinf(d.value) for d in doubts):
        held = "Every limit holds on the fine grid." if found.status.usable else found.message
        return Verdict(SolveStatus.CERTIFICATE_FAILED, f"{held} But {describe_slips(slipping)}")
    if not found.status.usable:
        differs = f"{found.message} And the optimiser's model of it differs: {listed}."
        return Verdict(found.status, differs)
    if any("torque" in d.quantity or abs(d.value) > _WRONG_MODEL_DIFFERENCE for d in doubts):
        every = (
            "Every limit"
            if motion.feasible(CERTIFICATE_TOLERANCE)
            else "Every limit but of collisions"
        )
        return Verdict(
            SolveStatus.CERTIFICATE_FAILED,
            f"{every} holds on the fine grid, but the optimiser's model of this motion is "
            f"wrong: it differs in {listed}. The motion is not the optimum; please report the "
            "robot and the problem.",
        )
    return Verdict(
        SolveStatus.ACCEPTABLE,
        "Solved and certified: every limit holds on the fine grid. But the optimiser's smooth "
        f"model of this motion differs in {listed}, so it is only near the optimum. "
        f"{model_accuracy_advice(problem)}",
    )


def model_accuracy_advice(problem: TrajectoryProblem) -> str:
    """Return advice on a closer fit of the optimiser's smooth model to the exact one."""
    if _contact_laws(problem) - {"log_cubic"}:
        return "contact_law = 'log_cubic' fits the exact law most closely."
    if problem.plans_links:
        return (
            f"More than {problem.method.intervals} method.intervals resolve the kinks of the "
            "joints' stiffness more closely."
        )
    return "Please report the robot and the problem."


def _significant_disagreements(problem: TrajectoryProblem, outcome: Outcome) -> list[Disagreement]:
    """Return the disagreements beyond their tolerances, worst first."""
    widths = smoothing_stages(problem)
    believed = predict_motion(problem, outcome.planned, outcome.smoothing, elastic=len(widths) > 1)
    return [d for d in find_disagreements(problem, outcome.trajectory, believed) if d.excess > 1.0]


def _contact_laws(problem: TrajectoryProblem) -> set[object]:
    """Return the contact laws in the robot's drivetrains."""
    elements = [e for c in problem.robot.chains if c is not None for e in c.elements.values()]
    return {e.contact_law for e in elements if hasattr(e, "contact_law")}


def find_better_baseline(
    problem: TrajectoryProblem, outcome: Outcome, compared: dict[str, Baseline]
) -> Baseline | None:
    """Return the best baseline that keeps every limit, None where the motion is as good."""
    best = better_baseline(problem, compared)
    if best is None or best.objective is None:
        return None
    if not outcome.assessment.feasible(CERTIFICATE_TOLERANCE):
        return best
    own, rival = objective_value(problem, outcome.assessment).value, best.objective
    gain = rival - own if is_maximised(problem) else own - rival
    # A baseline may benefit from the tolerance of the limits: it must be better by more than that.
    return best if gain > CERTIFICATE_TOLERANCE * max(abs(own), abs(rival)) else None


def describe_optimality(
    problem: TrajectoryProblem, compared: dict[str, Baseline], starts_made: int
) -> str:
    """Return a sentence on an optimum: local or global, number of starts, better baselines."""
    kept = [each.name for each in compared.values() if each.feasible]
    tried = "one start" if starts_made == 1 else f"the best of {starts_made} starts"
    rivals = ""
    if compared and not kept:
        rivals = "; no baseline keeps every limit within the duration"
    elif kept and not (problem.judges_uncertain_arms or problem.leads_when_fastest):
        # Else the commands are compared.
        rivals = f"; no baseline that keeps every limit ({', '.join(kept)}) has a better objective"
    return f"It is a local optimum, from {tried}{rivals}. More method.starts look further."


def _solve_status(outcome: Outcome) -> SolveStatus:
    raw, certified = outcome.raw, outcome.assessment.feasible(CERTIFICATE_TOLERANCE)
    if raw.converged:
        if not certified:
            return SolveStatus.CERTIFICATE_FAILED
        exact = raw.status == "optimal" and not raw.rough
        full = exact and outcome.objective_gap <= MAX_OBJECTIVE_GAP
        return SolveStatus.OPTIMAL if full else SolveStatus.ACCEPTABLE
    if raw.status == "infeasible" or (raw.status == "stalled" and not certified):
        return SolveStatus.INFEASIBLE
    if raw.status in ("interrupted", "time_limit"):
        return SolveStatus(raw.status)
    return SolveStatus.ITERATION_LIMIT


def _status_message(
    problem: TrajectoryProblem,
    outcome: Outcome,
    motion: Assessment,
    corrections: Sequence[Mapping[str, Any]],
) -> str:
    status, raw, assessment = _solve_status(outcome), outcome.raw, outcome.assessment
    worst = assessment.worst_violation.describe()
    if status is SolveStatus.INFEASIBLE:
        return (
            f"{status.sentence} These conflict: {named_conflicts(raw.conflicts or raw.worst_rows)}."
        )
    if not raw.converged:
        state = f" It exceeds {worst}."
        if raw.violation > FEASIBLE_VIOLATION and raw.worst_rows:
            furthest = named_conflicts([raw.worst_rows[0].entry])
            state += f" Worst row of the programme: {furthest}."
        if assessment.feasible(CERTIFICATE_TOLERANCE):
            state = " It keeps all limits." if motion.feasible(CERTIFICATE_TOLERANCE) else ""
        if raw.status == "stalled":
            return (
                "The solver stalled before the optimum; the result is the best motion so far."
                f"{state} Try method.starts = 3 or another method.intervals."
            )
        cause = f" Cause: {raw.reason}." if raw.status == "invalid_number" else ""
        return f"{status.sentence}{cause}{state}"
    if status is SolveStatus.CERTIFICATE_FAILED:
        return f"{status.sentence} It exceeds {worst}. {_describe_remedy(corrections)}"
    if outcome.slowed:
        return (
            f"Certified, but only near the optimum. {outcome.slowed} More method.intervals may "
            "find one that needs no slowing."
        )
    if outcome.objective_gap > MAX_OBJECTIVE_GAP:
        lacking = _missing_friction_share(problem, outcome.trajectory, outcome.smoothing)
        if lacking > _MIN_FRICTION_SHARE * outcome.objective_gap:
            return (
                "Solved and certified: every limit holds on the fine grid. But the objective is "
                f"{outcome.objective_gap:.1%} worse than the optimiser's: joints creep so slowly "
                "that its smoothed dry friction is less than the exact one, which no finer mesh "
                "corrects. The value given is the exact one; a shorter motion creeps less."
            )
        return (
            "Solved and certified: every limit holds on the fine grid. But between the nodes the "
            f"objective is {outcome.objective_gap:.1%} worse than at them, so a finer mesh or "
            "another transcription can still improve it; the value given is the exact one."
        )
    if status is SolveStatus.OPTIMAL:
        held = {v.limit for v in assessment.violations}
        listed = ", ".join(each for each in ("position", *DRIVE_LIMITS) if each in held)
        return status.sentence.replace(
            ". ",
            f", so the motion may be run as far as {listed} and the stated requirements go. ",
            1,
        )
    if raw.reason in ("stalled", "iteration_limit"):
        return (
            "Certified: every limit holds on the fine grid. But the last solve ended before its "
            f"optimum after {raw.iterations} iterations ({raw.reason}), within 1 % of the objective"
            " that is predicted there. method.starts = 3 tries other motions."
        )
    return status.sentence


def _describe_remedy(corrections: Sequence[Mapping[str, Any]]) -> str:
    """Return advice on a limit that is exceeded between the nodes, by how its corrections ended."""
    converged = ("", "optimal", "acceptable")
    failed = [each for each in corrections if each["ended"] not in converged]
    if not failed:
        return "Raise method.intervals, or lower the scale of the named limit."
    last = failed[-1]
    return (
        f"The solve that was to correct it ({last['step']}: {last['reason']}) ended without an "
        f"optimum after {last['iterations']} iterations ({last['ended']}), which more "
        "method.intervals need not change: allow a longer duration, try method.starts = 3, or lower"
        " the scale of the named limit."
    )


def _missing_friction_share(
    problem: TrajectoryProblem, motion: Trajectory, smoothing: Smoothing
) -> float:
    """Return the share of squared torque that smoothed dry friction misses at the nodes.

    Relative to the exact one; 0 where no torque is minimised.
    """
    if not any(objective.kind.of_drives for objective in problem.objectives):
        return 0.0
    believed = predict_motion(problem, motion, smoothing, elastic=False)
    if believed.torque is None:
        return 0.0
    true = assess(problem, motion, times=believed.time).torque
    size = problem.robot.torque_max
    sums = [
        np.trapezoid(((torque / size) ** 2).sum(axis=1), believed.time)
        for torque in (believed.torque, true)
    ]
    return float(1.0 - sums[0] / sums[1]) if sums[1] > 0.0 else 0.0


def named_conflicts(entries: Sequence[NlpEntry | RowViolation]) -> str:
    """Return limits by name; the many values at start and end count as one entry, the last."""
    limits, ends = [], []
    for entry in entries:
        named = entry.entry if isinstance(entry, RowViolation) else entry
        given = named.given and named.name in _MOTION_BLOCKS
        if given or named.name.startswith(("start", "end")):
            ends = ["the given start and end"]
        else:
            limits.append(_name_bound_as_limit(str(entry)))
    return "; ".join(list(dict.fromkeys(limits))[:5] + ends) or "none that can be named"


def _name_bound_as_limit(entry: str) -> str:
    """Return a bound of the programme by the name of its limit."""
    found = _BOUND_ENTRY.match(entry)
    if found is None:
        return entry
    kind, quantity, rest = found.groups()
    if kind == "control rate":
        quantity = _DERIVATIVE_NAMES.get(quantity, f"rate of {quantity}")
    return f"{quantity}, {rest}"
