"""Residual vibration: a motion planned for the links is compared with the simulated arm.

The same links get the motors of least vibration, by a sharper motor law and by a small change of
their motion. Where the arm still exceeds a limit after arrival, or leaves its plan, limits are
backed off on the same mesh, since long chains of integrators converge poorly on a new one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.certificate.assess import assess, drive_violations
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE, DRIVE_LIMITS
from stiffopt.errors import NotSimulatedError
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.solver.exact_rows import (
    TARGET_EXCESS,
    ExactRows,
    allows_other_motion,
    concerns_arrival,
    describe_excess,
    worst_flight_violation,
)
from stiffopt.solver.exchange import OutcomeOracle, Proposal, Rank, exchange, keep_better
from stiffopt.solver.programme import Outcome, motors_with_law, solve_again
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.vibration_suppression import SimulatedMotors, suppress_vibration
from stiffopt.transcription.constraint_back_off import back_off_uniformly
from stiffopt.transcription.nlp import Nlp

_MAX_BACK_OFFS = 3
# Share of the drive limits that the first back-off reserves for vibration suppression.
_DRIVE_RESERVE = 0.04
# Share of the jerk limit, which kinks of the stiffness use most, in each later back-off.
_JERK_RESERVE = 0.15
# Deviation of the simulated arm from its plan, in flight and after arrival, over the plan's peak.
_MAX_PLAN_DEVIATION = 5e-2
# Shares of the motor law's smoothing widths, tried when all limits hold: at half of it the residual
# vibration is that of the exact law.
_SHARPER_LAW_SHARES = (0.5, 0.6, 0.7, 0.8, 0.9)


def refine_within_mesh(run: SolveRun, outcome: Outcome) -> Outcome:
    """Back off rows on the same mesh where the exact ones, or the simulated arm, exceed them."""
    start = suppress_vibration_of_links(run, exchange(run, ExactRows(run), outcome))
    return exchange(run, ArrivalVibration(run), start)


class ArrivalVibration(OutcomeOracle):
    """Limits after arrival, and the deviation of the simulated arm from its plan."""

    step = "residual vibration"
    explores = False

    def __init__(self, run: SolveRun) -> None:
        super().__init__(run)
        self.rounds = _MAX_BACK_OFFS

    def rank(self, found: Outcome) -> Rank:
        """Return the sum of the simulated peaks; infinite where a limit after arrival is exceeded.

        So it is where the arm is not simulated.
        """
        late = _arrival_overshoot(self.run.problem, found.assessment)
        return (np.inf if late or found.arm is None else found.arm.reach,)

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return a solve with limits backed off; None for an arm that is near its plan."""
        late = _arrival_overshoot(self.run.problem, last.assessment)
        asked = self._requested_back_off(last, late, number)
        if not (asked and last.raw.converged):
            return None
        closer = back_off_uniformly(last.nlp, asked)
        if not allows_other_motion(closer, last.nlp, moved=False):
            return None
        reason = describe_excess(late) or "the simulated arm leaves its plan"
        return Proposal(reason, lambda: self._solve(last, closer))

    def _solve(self, last: Outcome, closer: Nlp) -> Outcome:
        other = solve_again(self.run, last, closer, last.smoothing)
        if other.failed:
            return other
        return suppress_vibration_of_links(self.run, exchange(self.run, ExactRows(self.run), other))

    def _requested_back_off(
        self, outcome: Outcome, late: dict[str, float], number: int
    ) -> dict[str, float]:
        """Return the back-off by limit; empty for an arm near its plan.

        `late` are the limits that it exceeds after arrival.
        """
        wide = outcome.smoothing.lead > 1.0
        if any(block.rows.name in late for block in outcome.nlp.rows.items):
            # The rows overestimate the arm's vibration, so that back-off acts slowly. They do not
            # model the residual vibration of a wide smoothing at all.
            return {} if wide else {name: excess * 2.0**number for name, excess in late.items()}
        if late:
            # The plan ends at rest, the arm does not: vibration suppression lacks drive reserve.
            return (
                {"jerk": _JERK_RESERVE} if number else dict.fromkeys(DRIVE_LIMITS, _DRIVE_RESERVE)
            )
        off = 0.0 if outcome.arm is None else outcome.arm.off
        swings = any(each.kind.plans_links for each in self.run.problem.objectives)
        return {"jerk": _JERK_RESERVE} if swings and wide and off > _MAX_PLAN_DEVIATION else {}


def _sharpen_motor_law(run: SolveRun, outcome: Outcome) -> Outcome:
    """Return the same links with the sharpest motor law for which every limit holds.

    Residual vibration from smoothing decreases with its width; that from the links' sag vanishes
    for motors computed at the sagged position. The optimiser's rows model neither.
    """
    # With free arrival the motors are at rest only by the law that was solved.
    if worst_flight_violation(outcome.assessment) > CERTIFICATE_TOLERANCE or run.end_modes:
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


def suppress_vibration_of_links(run: SolveRun, outcome: Outcome) -> Outcome:
    """Return the same links with the least vibration: by a sharper law, then by a motor change.

    The latter where every limit holds in flight. With the simulated arm, where it was simulated.
    """
    if not outcome.raw.converged:
        return outcome
    outcome = _sharpen_motor_law(run, outcome)
    if run.lag is None or worst_flight_violation(outcome.assessment) > CERTIFICATE_TOLERANCE:
        return outcome
    try:
        arm = run.arm.with_fast_joints_following(run.motion.start)
        start = SimulatedMotors.of(arm, outcome.trajectory, outcome.assessment)
        found = suppress_vibration(run, arm, start, CERTIFICATE_TOLERANCE)
    except NotSimulatedError:
        return outcome
    changed = replace(outcome, trajectory=found.motors, assessment=found.assessment, arm=found)
    return keep_better(run, changed)


def _replace_motors(
    run: SolveRun, outcome: Outcome, share: float, *, sagged: bool
) -> Outcome | None:
    """Return the outcome with recomputed motors, None where they exceed a limit in flight."""
    trajectory = motors_with_law(run, outcome, share, sagged=sagged)
    if drive_violations(run.problem, trajectory)[0].value > CERTIFICATE_TOLERANCE:
        return None
    assessment = assess(run.problem, trajectory, led=outcome.assessment.led)
    if worst_flight_violation(assessment) > CERTIFICATE_TOLERANCE:
        return None
    return replace(outcome, trajectory=trajectory, assessment=assessment)


def _arrival_overshoot(problem: TrajectoryProblem, assessment: Assessment) -> dict[str, float]:
    """Return the limits that the arm exceeds after arrival, with the relative overshoot."""
    exceeded = {
        v.limit for v in assessment.violations if concerns_arrival(v) and v.value > TARGET_EXCESS
    }
    limits = problem.active_limits
    if assessment.simulated is None or assessment.simulated.peak_after is None:
        return {}
    return {name: LIMITS[name].overshoot(limits, assessment.simulated) for name in exceeded}
