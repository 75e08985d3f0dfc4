"""Exact limits between the nodes: path rows are backed off where the exact ones exceed them.

Rows hold at nodes and midpoints, and of a smoothed model. The exact ones are evaluated densely;
what a certificate finds beyond them, such as a delay by damping, is backed off uniformly. An excess
that a correction has not removed comes from a kink of the motor law, whose smoothing is widened.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from stiffopt.certificate.assess import drive_violations
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE, DRIVE_LIMITS
from stiffopt.command.smoothing_width import (
    KINK_EXCESS,
    MAX_REMAINING_EXCESS,
    TOLERABLE_KINK_EXCESS,
    narrowest_sufficient_width,
)
from stiffopt.problem.formulation import exact_path_rows
from stiffopt.problem.limit import LIMITS
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.solver.exchange import OutcomeOracle, Proposal, Rank, rank_outcome
from stiffopt.solver.programme import Outcome, motors_with_law, solve_again
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.verdict import MAX_OBJECTIVE_GAP
from stiffopt.transcription.constraint_back_off import (
    Excess,
    KnownRows,
    back_off_exceeded,
    back_off_states,
    back_off_uniformly,
    path_row_excess,
)
from stiffopt.transcription.nlp import Nlp
from stiffopt.transcription.point_function import PointFunction

# Back-off continues until the excess is below this: a margin to the certificate's tolerance.
TARGET_EXCESS = 0.8 * CERTIFICATE_TOLERANCE
MAX_CORRECTIONS = 12
# Largest back-off of a row in one step, as a share of its bound: a larger excess is a narrow peak,
# which less back-off removes.
_MAX_BACK_OFF_STEP = 0.15
# Share of an excess that the exact rows must show, else its cause lies outside the rows.
_MIN_EXPLAINED_SHARE = 0.5
# Share of the stiffness smoothing widths at which rows are checked where the objective is worse
# than predicted: kinks that the widths conceal show.
_CHECK_SMOOTHING_SHARE = 0.1
# Excess that no correction removes: the smoothing is widened before the first one.
_SPIKE_EXCESS = 4.0


class ExactRows(OutcomeOracle):
    """Exact path rows between the nodes; the mesh stays."""

    step = "constraint back-off"

    def __init__(self, run: SolveRun) -> None:
        super().__init__(run)
        self.rounds = MAX_CORRECTIONS

    @functools.cached_property
    def _rows(self) -> PointFunction:
        run = self.run
        return PointFunction(exact_path_rows(run.problem, run.motion, run.scales))

    def rank(self, found: Outcome) -> Rank:
        """Return the rank by the limits in flight: rows do not hold after arrival."""
        return rank_outcome(self.run, found, worst_flight_violation(found.assessment))

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return a correction with bounds backed off; None where all limits and the gap hold."""
        excess, gap, rough = excess_by_limit(last.assessment), last.objective_gap, last.raw.rough
        if not last.raw.converged or not (excess or gap > MAX_OBJECTIVE_GAP or rough):
            return None
        smoothing, worst = last.smoothing, max(excess.values(), default=0.0)
        if self.run.problem.plans_links and worst > (KINK_EXCESS if number else _SPIKE_EXCESS):
            smoothing = replace(smoothing, lead=_widen_motor_smoothing(self.run, last))
        share = _CHECK_SMOOTHING_SHARE if gap > MAX_OBJECTIVE_GAP else 1.0
        known = path_row_excess(
            last.transcription,
            last.raw.x,
            smoothing.narrowed(share).parameters,
            self._rows,
            _known_drive_rows(self.run.problem, last.assessment),
        )
        closer = back_off_exceeded(
            last.nlp, known, last.transcription.nlp, most=_MAX_BACK_OFF_STEP, limits=LIMITS
        )
        closer = back_off_uniformly(closer, _unexplained_excess(known, excess))
        if excess:
            led = self.run.problem.plans_links
            motors = KnownRows(last.assessment.time, last.assessment.position) if led else None
            closer = back_off_states(closer, last.transcription, last.raw.x, motors)
        if not allows_other_motion(closer, last.nlp, moved=rough or smoothing != last.smoothing):
            return None
        worse = f"objective {gap:.1%} worse between the nodes"
        reason = worse if gap > MAX_OBJECTIVE_GAP else "solved to a wide tolerance"
        return Proposal(
            describe_excess(excess) or reason,
            lambda: solve_again(self.run, last, closer, smoothing),
        )


def describe_excess(excess: dict[str, float]) -> str:
    """Return the limits with their relative excess, worst first."""
    worst = sorted(excess.items(), key=lambda each: -each[1])
    return ", ".join(f"{name} by {value:.2%}" for name, value in worst[:3])


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
    found = {}
    for name in DRIVE_LIMITS:
        if name == "torque" and np.any(problem.robot.coulomb):
            continue
        limit = np.broadcast_to(getattr(problem.active_limits, name), (problem.joints,))
        bounded = np.isfinite(limit)
        found[name] = KnownRows(motion.time, getattr(motion, name)[:, bounded] / limit[bounded])
    return found


def _unexplained_excess(known: Excess, excess: dict[str, float]) -> dict[str, float]:
    """Return excesses that the rows do not show, such as the delay by damping.

    Not of positions, which are states.
    """
    unseen = {
        k: v
        for k, v in excess.items()
        if k != "position" and known.largest.get(k, 0.0) < _MIN_EXPLAINED_SHARE * v
    }
    return {k: min(v, _MAX_BACK_OFF_STEP) for k, v in unseen.items()}


def allows_other_motion(nlp: Nlp, before: Nlp, *, moved: bool) -> bool:
    """Return True where bounds or (`moved`) more changed, and the bounds are consistent."""
    bounds = ("lower_g", "upper_g", "lower_x", "upper_x")
    same = all(np.array_equal(getattr(nlp, each), getattr(before, each)) for each in bounds)
    return (moved or not same) and bool(np.all(nlp.lower_g <= nlp.upper_g))


def excess_by_limit(assessment: Assessment) -> dict[str, float]:
    """Return excesses above the target by row name; start and end cannot be backed off."""
    fixed = ("start", "end")
    return {
        v.limit.replace("via_", "via "): v.value
        for v in assessment.violations
        if v.value > TARGET_EXCESS and not v.limit.startswith(fixed) and not concerns_arrival(v)
    }


def worst_flight_violation(assessment: Assessment) -> float:
    """Return the largest relative excess of a limit in flight."""
    flight = (v.value for v in assessment.violations if not concerns_arrival(v))
    return max(flight, default=-np.inf)


def concerns_arrival(violation: Violation) -> bool:
    """Return True for a limit on the tool after arrival."""
    kind = LIMITS.get(violation.limit)
    return kind is not None and kind.of_arrival
