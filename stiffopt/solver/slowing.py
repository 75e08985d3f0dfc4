"""Slowing: a motion that exceeds a limit, run more slowly along its path until every limit holds.

A fastest motion may pass a kink of the joints' stiffness so fast that corrections do not converge.
Its path is sound: jerk falls with the cube of the duration, so that a few per cent suffice.
"""

from __future__ import annotations

from dataclasses import replace

from stiffopt.certificate.assess import assess, drive_violations
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.solver.exact_rows import describe_excess, excess_by_limit
from stiffopt.solver.exchange import OutcomeOracle, Proposal, keep_better
from stiffopt.solver.programme import Outcome, follow_plan
from stiffopt.solver.solve_run import SolveRun

# Largest share by which a motion is slowed: beyond it another motion is likely much faster. And the
# share to which the least slowing is found.
_MAX_SLOWING, _SLOWING_ACCURACY = 0.25, 2e-3


class Slowing(OutcomeOracle):
    """Excess of a limit that no correction removed, where the duration is free."""

    step = "slowing"
    rounds = 1

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return the slowed motion; None where every limit holds, or for another reason."""
        problem = self.run.problem
        if last.assessment.feasible(CERTIFICATE_TOLERANCE) or not problem.rests_at_both_ends:
            return None
        room = problem.duration[1] / last.planned.duration - 1.0
        if room <= _SLOWING_ACCURACY or last.raw.status == "infeasible":
            return None
        reason = describe_excess(excess_by_limit(last.assessment)) or "a limit is exceeded"
        return Proposal(reason, lambda: self._slow_down(last, min(room, _MAX_SLOWING)))

    def _slow_down(self, last: Outcome, most: float) -> Outcome:
        """Return the motion slowed by the least share up to `most`, itself where none suffices."""
        found, low, high = last, 0.0, most
        share = min(most, _SLOWING_ACCURACY)
        while high - low > _SLOWING_ACCURACY or found is last:
            tried = slow_down(self.run, last, 1.0 + share)
            if tried is not None and tried.assessment.feasible(CERTIFICATE_TOLERANCE):
                found, high = tried, share
            elif share == most:
                return last
            else:
                low = share
            # Doubled until every limit holds, then halved towards the least.
            share = min(2.0 * share, most) if found is last else 0.5 * (low + high)
        slowed = (
            f"No correction kept {describe_excess(excess_by_limit(last.assessment))}: the motion "
            f"is slowed by {100.0 * high:.2g} % along its path, so that every limit holds."
        )
        return keep_better(self.run, replace(found, slowed=slowed))


def slow_down(run: SolveRun, outcome: Outcome, factor: float) -> Outcome | None:
    """Return an outcome's motion with a factor on its duration, None where drives exceed a limit.

    Its solve counts as ended before the optimum.
    """
    planned = outcome.planned.scaled_to(factor * outcome.planned.duration)
    trajectory = follow_plan(run, planned, outcome.smoothing.law)
    if drive_violations(run.problem, trajectory)[0].value > CERTIFICATE_TOLERANCE:
        return None
    return replace(
        outcome,
        raw=replace(outcome.raw, status="acceptable"),
        planned=planned,
        trajectory=trajectory,
        assessment=assess(run.problem, trajectory),
        objective_gap=0.0,
        arm=None,
    )
