"""How a solve ended, as a status and a sentence: what the solver says, then what is true of it.

A motion is optimal only if it keeps all limits on the fine grid, if the optimiser believed of it
what is true, and if no baseline that keeps all limits is better.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.certificate.agreement import Disagreement, differences
from stiffopt.certificate.collisions import LIMIT as COLLISION
from stiffopt.certificate.collisions import scope
from stiffopt.certificate.objective_value import is_maximised, objective_value
from stiffopt.certificate.slipping import slip_text, slips
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.problem.formulation import smoothing_stages
from stiffopt.problem.prediction import predict_motion
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import Baseline
from stiffopt.result.status import SolveStatus
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.ipopt import FEASIBLE
from stiffopt.solver.stages import Outcome
from stiffopt.solver.standstill import lacking_friction
from stiffopt.transcription.nlp import NlpEntry, RowViolation

# An objective worse on the fine grid than at the nodes by more than this share asks for refinement,
# and is never called optimal.
TRUE_OBJECTIVE = 2e-2
# A wind-up or deflection further off is no fit of a contact law any more: "power_law" misses the
# fractal law by up to 5 %.
_WRONG = 6e-2
# Share of a gap from which on it is told as the cause.
_MOST = 0.5
# Ratio of every baseline's deflection to its limit from which on that is told as out of reach: no
# optimum has been seen so far below them.
_OUT_OF_REACH = 10.0
# A baseline may use what limits may be exceeded by: it has to be better by more than that share.
_WORSE = CERTIFIED
# Bounds of states and controls in a programme are limits of the joints: "control rate, acceleration
# of joint 1 (at 50 %)" is that of the jerk.
_BOUND = re.compile(r"(state|control|control rate|\w+ within interval), (\w+) of (joint .*)")
# Blocks of the programme that hold the motion itself: what is given in them is start or end.
_MOTION = ("state", "control", "control at the start", "spline")
# Limits of joints; of some a robot and its problem may state none.
_OF_JOINTS = ("position", "velocity", "acceleration", "jerk", "torque")
_RATES = {"velocity": "acceleration", "acceleration": "jerk"}


@dataclass(frozen=True)
class Verdict:
    """Status of a solve and the sentence that goes with it."""

    status: SolveStatus
    message: str


def verdict(
    problem: TrajectoryProblem, outcome: Outcome, motion: Assessment, beside: dict[str, Baseline]
) -> Verdict:
    """Judge an outcome by its solver, the certificate, its own belief and the baselines.

    `motion` is its assessment with the rows of its collisions, which `beyond_limits` judges.
    """
    own = Verdict(_status(outcome), _message(problem, outcome, motion))
    found = _by_belief(problem, outcome, motion, own)
    if not motion.feasible(CERTIFIED) and (beyond := _out_of_reach(problem, beside)):
        # Its general advice is to relax what is named, or to take more time.
        rest = found.message.removeprefix(found.status.sentence)
        found = Verdict(found.status, f"{beyond}{rest}")
    better = baseline_above(problem, outcome, beside)
    if better is None or found.status is SolveStatus.INFEASIBLE:
        return found
    optimal = found.status is SolveStatus.OPTIMAL
    return Verdict(
        SolveStatus.ACCEPTABLE if optimal else found.status,
        f"{found.message} But the {better.name} motion beside it {_virtue(outcome)}: run that one, "
        "or raise method.intervals or method.starts.",
    )


def _out_of_reach(problem: TrajectoryProblem, beside: dict[str, Baseline]) -> str:
    """What keeps a limit on the dynamic deflection out of reach, "" where nothing is seen to."""
    cap = float(problem.active_limits.dynamic_deflection)
    peaks = {
        name: (float(np.linalg.norm(motion.deflection["dynamic"], axis=1).max()), motion.time[-1])
        for name, baseline in beside.items()
        if (motion := baseline.assessment) is not None
    }
    if not peaks or not math.isfinite(cap):
        return ""
    name = min(peaks, key=lambda each: peaks[each][0])
    peak, lasted = peaks[name]
    if peak < _OUT_OF_REACH * cap:
        return ""
    return (
        f"limits.dynamic_deflection = {1e3 * cap:.3g} mm is hardly to be met: what accelerates the"
        f" arm winds its joints up, by {1e3 * peak:.3g} mm at the tool in the {name} motion of"
        f" {lasted:.3g} s. That falls with the square of the duration: allow about"
        f" {lasted * math.sqrt(peak / cap):.2g} s, or raise the limit; more time to solve does not"
        " help."
    )


def beyond_limits(
    problem: TrajectoryProblem, motion: Assessment, found: Verdict, tried: str = ""
) -> Verdict:
    """The verdict of a motion that may collide; a usable one says what that was checked for.

    Parameters
    ----------
    problem : TrajectoryProblem
    motion : Assessment
        With the rows of its collisions.
    found : Verdict
    tried : str
        What was done in vain to avoid them.
    """
    exceeded = [v for v in motion.violations if v.value > CERTIFIED]
    hits = [v for v in exceeded if v.limit == COLLISION]
    listed = "; ".join(hit.describe() for hit in hits[:3])
    if hits and found.status.usable:
        told = f"{listed}. {tried}".strip()
        return Verdict(
            SolveStatus.CERTIFICATE_FAILED,
            f"Every other limit holds on the fine grid, but the motion does not keep {told} "
            "Do not run it; lead it around by motion.via, or change its start or end.",
        )
    if hits and found.status is not SolveStatus.INFEASIBLE:
        word = "And" if len(exceeded) > len(hits) else "But"
        text = f"{found.message} {word} it does not keep {listed}: do not run it."
        return Verdict(found.status, text)
    if not found.status.usable:
        return found
    return Verdict(found.status, f"{found.message} {scope(problem)}".strip())


def _by_belief(
    problem: TrajectoryProblem, outcome: Outcome, motion: Assessment, found: Verdict
) -> Verdict:
    """The verdict, unless the optimiser believed of its motion what is not true."""
    doubts = _disagreements(problem, outcome) if outcome.raw.converged else []
    if not doubts:
        return found
    listed = "; ".join(d.describe() for d in doubts[:3])
    slipping = slips(problem.robot, motion)
    if slipping and any(np.isinf(d.value) for d in doubts):
        held = "Every limit holds on the fine grid." if found.status.usable else found.message
        return Verdict(SolveStatus.CERTIFICATE_FAILED, f"{held} But {slip_text(slipping)}")
    if not found.status.usable:
        differs = f"{found.message} And the optimiser believed otherwise: {listed}."
        return Verdict(found.status, differs)
    if any("torque" in d.quantity or abs(d.value) > _WRONG for d in doubts):
        every = "Every limit" if motion.feasible(CERTIFIED) else "Every limit but of collisions"
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
        f"{closer_model(problem)}",
    )


def closer_model(problem: TrajectoryProblem) -> str:
    """What makes the optimiser's smooth model come closer to the exact one, as a sentence."""
    if _contact_laws(problem) - {"log_cubic"}:
        return "contact_law = 'log_cubic' follows the true law most closely."
    if problem.plans_links:
        return (
            f"More than {problem.method.intervals} method.intervals let it follow the bends of the "
            "joints' laws more closely."
        )
    return "Please report the robot and the problem."


def _disagreements(problem: TrajectoryProblem, outcome: Outcome) -> list[Disagreement]:
    """What the optimiser believed of its motion and is not true, the worst first."""
    widths = smoothing_stages(problem)
    polynomials = outcome.transcription.acceleration_polynomials(outcome.raw.x)
    believed = predict_motion(
        problem,
        Trajectory.from_acceleration(*polynomials),
        outcome.smoothing,
        elastic=len(widths) > 1,
    )
    return [d for d in differences(problem, outcome.trajectory, believed) if d.excess > 1.0]


def _contact_laws(problem: TrajectoryProblem) -> set[object]:
    """Fits of contacts in the robot's drivetrains."""
    elements = [e for c in problem.robot.chains if c is not None for e in c.elements.values()]
    return {e.contact_law for e in elements if hasattr(e, "contact_law")}


def baseline_above(
    problem: TrajectoryProblem, outcome: Outcome, beside: dict[str, Baseline]
) -> Baseline | None:
    """A baseline that keeps every limit, its own method's or not, and is better, or alone in it."""
    certified = outcome.assessment.feasible(CERTIFIED)
    value = objective_value(problem, outcome.assessment).value
    sign = -1.0 if is_maximised(problem) else 1.0
    for baseline in beside.values():
        motion, rival = baseline.assessment, baseline.objective
        if not baseline.feasible or motion is None or rival is None:
            continue
        better = sign * (value - rival) > _WORSE * max(abs(value), abs(rival))
        if motion.feasible(CERTIFIED) and (better or not certified):
            return baseline
    return None


def has_one_optimum(problem: TrajectoryProblem, beside: dict[str, Baseline]) -> bool:
    """Return True where the problem is known to have no local optimum beside the global one.

    That is the shortest duration on a fixed path, as far as limits go that toppra takes: they are
    convex in the square of the path speed.
    """
    toppra = beside.get("toppra")
    fastest = [each.name for each in problem.objectives] == ["duration"]
    return (
        problem.path is not None
        and fastest
        and toppra is not None
        and toppra.feasible
        and toppra.assessment is not None
        and toppra.assessment.feasible(CERTIFIED)
    )


def optimum_reach(problem: TrajectoryProblem, beside: dict[str, Baseline], starts_made: int) -> str:
    """Sentence on how far an optimum is known to be one: local or global, and what was tried."""
    kept = [
        each.name
        for each in beside.values()
        if each.feasible and each.assessment is not None and each.assessment.feasible(CERTIFIED)
    ]
    if has_one_optimum(problem, beside):
        return "On a given path the shortest duration is the global optimum."
    tried = "one start" if starts_made == 1 else f"the best of {starts_made} starts"
    rivals = (
        f"no baseline that keeps every limit ({', '.join(kept)}) is better"
        if kept
        else "no baseline keeps every limit within the duration"
    )
    return f"It is a local optimum, from {tried}; {rivals}. More method.starts look further."


def _virtue(outcome: Outcome) -> str:
    if outcome.assessment.feasible(CERTIFIED):
        return "is better and keeps all limits as well"
    return "keeps all limits"


def _status(outcome: Outcome) -> SolveStatus:
    raw, certified = outcome.raw, outcome.assessment.feasible(CERTIFIED)
    if raw.converged:
        if not certified:
            return SolveStatus.CERTIFICATE_FAILED
        full = raw.status == "optimal" and outcome.objective_gap <= TRUE_OBJECTIVE
        return SolveStatus.OPTIMAL if full else SolveStatus.ACCEPTABLE
    if raw.status == "infeasible" or (raw.status == "stalled" and not certified):
        return SolveStatus.INFEASIBLE
    if raw.status in ("interrupted", "time_limit"):
        return SolveStatus(raw.status)
    return SolveStatus.ITERATION_LIMIT


def _message(problem: TrajectoryProblem, outcome: Outcome, motion: Assessment) -> str:
    status, raw, assessment = _status(outcome), outcome.raw, outcome.assessment
    worst = assessment.worst_violation.describe()
    if status is SolveStatus.INFEASIBLE:
        return (
            f"{status.sentence} These conflict: {named_conflicts(raw.conflicts or raw.worst_rows)}."
        )
    if not raw.converged:
        state = f" It exceeds {worst}."
        if raw.violation > FEASIBLE and raw.worst_rows:
            furthest = named_conflicts([raw.worst_rows[0].entry])
            state += f" Furthest from being kept in the programme: {furthest}."
        if assessment.feasible(CERTIFIED):
            state = " It keeps all limits." if motion.feasible(CERTIFIED) else ""
        if raw.status == "stalled":
            return (
                "The solver made no further progress before the optimum; the best motion so far is "
                f"kept.{state} Try method.starts = 3 or another method.intervals."
            )
        cause = f" Cause: {raw.reason}." if raw.status == "invalid_number" else ""
        return f"{status.sentence}{cause}{state}"
    if status is SolveStatus.CERTIFICATE_FAILED:
        return f"{status.sentence} It exceeds {worst}."
    if outcome.objective_gap > TRUE_OBJECTIVE:
        lacking = lacking_friction(problem, outcome.trajectory, outcome.smoothing)
        if lacking > _MOST * outcome.objective_gap:
            return (
                "Solved and certified: every limit holds on the fine grid. But the objective is "
                f"{outcome.objective_gap:.1%} worse than the optimiser believed: joints creep so "
                "slowly that its smooth dry friction is less than theirs, which no mesh mends. The "
                "value given is the true one; a shorter motion creeps less."
            )
        return (
            "Solved and certified: every limit holds on the fine grid. But between the nodes the "
            f"objective is {outcome.objective_gap:.1%} worse than at them, so a finer mesh or "
            "another transcription can still improve it; the value given is the true one."
        )
    if status is SolveStatus.OPTIMAL:
        held = {v.limit for v in assessment.violations}
        listed = ", ".join(each for each in _OF_JOINTS if each in held)
        return status.sentence.replace(
            ". ",
            f", so the motion may be run as far as {listed} and the stated requirements go. ",
            1,
        )
    return status.sentence


def named_conflicts(entries: Sequence[NlpEntry | RowViolation]) -> str:
    """Limits by name first; the many values at start and end count as one entry, the last."""
    limits, ends = [], []
    for entry in entries:
        named = entry.entry if isinstance(entry, RowViolation) else entry
        given = named.given and named.name in _MOTION
        if given or named.name.startswith(("start", "end")):
            ends = ["the given start and end"]
        else:
            limits.append(_as_limit(str(entry)))
    return "; ".join(list(dict.fromkeys(limits))[:5] + ends) or "none that can be named"


def _as_limit(entry: str) -> str:
    """A bound of the programme by the name of the limit it is."""
    found = _BOUND.match(entry)
    if found is None:
        return entry
    kind, quantity, rest = found.groups()
    if kind == "control rate":
        quantity = _RATES.get(quantity, f"rate of {quantity}")
    return f"{quantity}, {rest}"
