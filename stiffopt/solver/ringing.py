"""Ringing after arrival beside that of the best rival, whose smooth time law hardly excites modes.

The optimiser's ringing is an estimate up to a factor. Where the simulated worst arm is worse than
the best rival's in one phase, the weight between the phases is changed by that much.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from stiffopt.command.compensation import rival_commands
from stiffopt.command.simulation import elastic_arm, rival_motions
from stiffopt.errors import NotSimulatedError
from stiffopt.result.tool_error import LedError
from stiffopt.solver.arrival import refine_within_mesh
from stiffopt.solver.exchange import OutcomeOracle, Proposal, Rank
from stiffopt.solver.programme import Outcome, solve_again
from stiffopt.solver.rival_errors import RivalErrors
from stiffopt.solver.solve_run import SolveRun

_MAX_ROUNDS = 2
# Largest factor on the weight of the ringing in one round.
_MAX_WEIGHT_FACTOR = 5.0
# Error after arrival over the best rival's for which the weight is changed: the motion is judged by
# an ideal command here, rivals by those within their limits.
_TARGET_RATIO = 0.8


class RingingBesideRivals(OutcomeOracle):
    """Worst errors in flight, after arrival and across the path, none above the best rival's."""

    step = "ringing beside the best rival"
    rounds = _MAX_ROUNDS
    explores = False

    def __init__(self, run: SolveRun, outcome: Outcome) -> None:
        super().__init__(run)
        self._rivals = RivalErrors(run, [])
        if not (run.problem.judges_uncertain_arms and outcome.raw.converged):
            return
        with suppress(NotSimulatedError):
            arm, duration = elastic_arm(run.problem, run.motion.start), outcome.assessment.duration
            motions = rival_motions(run.problem, run.motion, duration)
            found = rival_commands(run.problem, arm, motions, run.motors)
            run.rivals = duration, motions, found
            errors = [
                (
                    each.motion.duration,
                    LedError(
                        in_flight=each.compensated.flight.worst,
                        after_arrival=each.compensated.after.worst,
                        across=each.compensated.flight.parts["across"].worst,
                        shares={},
                    ),
                )
                for each in found
                if not each.excess
            ]
            self._rivals = RivalErrors(run, errors)

    def rank(self, found: Outcome) -> Rank:
        """Return the rank with the larger excess over the rival before the objective."""
        excess, late, value = super().rank(found)
        return excess, late, max(*self._ratios(found), 1.0), value

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return a solve with another weight; None where that cannot help."""
        flight, after, _ = self._ratios(last)
        if max(flight, after) <= 1.0 or not last.raw.converged:
            return None
        # The ringing falls about with the root of its weight.
        factor = np.clip((after / _TARGET_RATIO) ** 2, 1.0 / _MAX_WEIGHT_FACTOR, _MAX_WEIGHT_FACTOR)
        if (factor > 1.0) != (after > 1.0):
            return None
        weight = (1.0 + last.smoothing.robust) * factor
        where = "after arrival" if after > flight else "in flight"
        reason = f"the worst arm is {max(flight, after):.2f} times the best rival's {where}"
        return Proposal(reason, lambda: self._solve(last, float(weight) - 1.0))

    def _ratios(self, found: Outcome) -> tuple[float, ...]:
        return self._rivals.ratios(found.planned, found.assessment.led)

    def _solve(self, last: Outcome, robust: float) -> Outcome:
        found = solve_again(self.run, last, last.nlp, replace(last.smoothing, robust=robust))
        return refine_within_mesh(self.run, found) if found.raw.converged else found
