"""Worst tool errors of a motion beside those of its rivals, at equal duration.

A rival that needs longer is compared with the same motion slowed to its duration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from stiffopt.command.compensation import rival_commands
from stiffopt.command.simulation import elastic_arm, rival_motions
from stiffopt.elastic.led_error import led_error
from stiffopt.errors import NotSimulatedError
from stiffopt.result.compensation import MIN_SLOWDOWN
from stiffopt.result.tool_error import LedError
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.programme import Outcome
from stiffopt.solver.solve_run import SolveRun


def search_rivals(run: SolveRun, outcome: Outcome) -> None:
    """Search the rivals of an optimum that uncertain arms judge, and their commands, for `run`."""
    if not (run.problem.judges_uncertain_arms and outcome.raw.converged):
        return
    with suppress(NotSimulatedError):
        arm, duration = elastic_arm(run.problem, run.motion.start), outcome.assessment.duration
        motions = rival_motions(run.problem, run.motion, duration)
        run.rivals = duration, motions, rival_commands(run.problem, arm, motions, run.motors)


class RivalErrors:
    """Errors of rivals at their durations [s], beside which those of an ideal lead are judged."""

    def __init__(self, run: SolveRun, rivals: Sequence[tuple[float, LedError]]) -> None:
        self._run = run
        compared = [each for each in rivals if min(each[1].in_flight, each[1].after_arrival)]
        # Beside a slower one the motion is simulated once more.
        self._rivals = sorted(compared, key=lambda each: each[0])

    def ratios(
        self, plan: Trajectory, led: LedError | None, largest: float = np.inf
    ) -> tuple[float, ...]:
        """Return the errors over the best rival's, as of `LedError.ratios_to`; zeros without one.

        The best rival is the one beside which the sum of both phases is largest. The first one
        beside which it is above `largest` will do: one of the errors is above it there too.
        """
        found = 0.0, (0.0,) * len(LedError.KINDS)
        for own, rival in [] if led is None else self._pairs(plan, led):
            found = max(found, (own.whole / rival.whole, own.ratios_to(rival)))
            if found[0] > largest:
                break
        return found[1]

    def _pairs(self, plan: Trajectory, led: LedError) -> Iterator[tuple[LedError, LedError]]:
        """Yield errors of the motion, and of a rival, at equal duration."""
        for duration, rival in self._rivals:
            slower = duration > (1.0 + MIN_SLOWDOWN) * plan.duration
            beaten = max(led.ratios_to(rival)) <= 1.0
            # A slower rival that is better in no error would be beaten by more.
            fair = not slower or beaten
            yield led if fair else self.of_plan(plan.scaled_to(duration)), rival

    def of_plan(self, plan: Trajectory, below: float = np.inf) -> LedError:
        """Return the errors of a motion of the links, led ideally; `below` as of `led_error`."""
        problem = self._run.problem
        return led_error(self._run.arm, plan, problem.uncertainty, problem.servo, below)
