"""Ringing after arrival beside that of the best rival, whose smooth time law hardly excites modes.

The optimiser's ringing is an estimate up to a factor. Where the simulated worst arm is worse than
the best rival's in one phase, the weight between the phases is changed by that much.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.command.simulation import rivals_of
from stiffopt.result.tool_error import LedError
from stiffopt.solver.arrival import refine_within_mesh
from stiffopt.solver.exchange import OutcomeOracle, Proposal, Rank
from stiffopt.solver.programme import Outcome, solve_again
from stiffopt.solver.solve_run import SolveRun

_MAX_ROUNDS = 2
# Largest factor on the weight of the ringing in one round.
_MAX_WEIGHT_FACTOR = 5.0


class RingingBesideRivals(OutcomeOracle):
    """Worst errors in flight and after arrival, neither above that of the best rival."""

    step = "ringing beside the best rival"
    rounds = _MAX_ROUNDS
    explores = False

    def __init__(self, run: SolveRun, outcome: Outcome) -> None:
        super().__init__(run)
        self._best: LedError | None = None
        if any(each.kind.of_uncertain_arms for each in run.problem.objectives):
            duration = outcome.assessment.duration
            found = [each.led for _, each in rivals_of(run.problem, run.motion, duration)]
            self._best = min(
                (each for each in found if each is not None),
                key=lambda each: each.whole,
                default=None,
            )

    def rank(self, found: Outcome) -> Rank:
        """Return the rank with the larger excess over the rival before the objective."""
        excess, late, value = super().rank(found)
        return excess, late, max(*self._ratios(found), 1.0), value

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return a solve with another weight; None where the rival is worse in both phases."""
        flight, after = self._ratios(last)
        if max(flight, after) <= 1.0 or not last.raw.converged or min(flight, after) > 1.0:
            return None
        factor = np.clip(after / flight, 1.0 / _MAX_WEIGHT_FACTOR, _MAX_WEIGHT_FACTOR)
        weight = (1.0 + last.smoothing.robust) * factor
        where = "after arrival" if after > flight else "in flight"
        reason = f"the worst arm is {max(flight, after):.2f} times the best rival's {where}"
        return Proposal(reason, lambda: self._solve(last, float(weight) - 1.0))

    def _ratios(self, found: Outcome) -> tuple[float, float]:
        own, best = found.assessment.led, self._best
        if own is None or best is None or not min(best.in_flight, best.after_arrival) > 0.0:
            return 0.0, 0.0
        return own.in_flight / best.in_flight, own.after_arrival / best.after_arrival

    def _solve(self, last: Outcome, robust: float) -> Outcome:
        found = solve_again(self.run, last, last.nlp, replace(last.smoothing, robust=robust))
        return refine_within_mesh(self.run, found) if found.raw.converged else found
