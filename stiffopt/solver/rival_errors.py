"""Worst tool errors of a motion beside those of its rivals, at equal duration.

A rival that needs longer is compared with the same motion slowed to its duration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stiffopt.elastic.worst_arms import led_error
from stiffopt.result.compensation import MIN_SLOWDOWN
from stiffopt.result.tool_error import LedError
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.solve_run import SolveRun


class RivalErrors:
    """Errors of rivals at their durations [s], beside which those of an ideal lead are judged."""

    def __init__(self, run: SolveRun, rivals: Sequence[tuple[float, LedError]]) -> None:
        self._run = run
        self._rivals = [each for each in rivals if min(each[1].in_flight, each[1].after_arrival)]

    def ratios(self, plan: Trajectory, led: LedError | None) -> tuple[float, float]:
        """Return the errors over the best rival's, in flight and after arrival; zeros without one.

        The best rival is the one beside which the sum of both is largest.
        """
        pairs = [] if led is None else list(self._pairs(plan, led))
        if not pairs:
            return 0.0, 0.0
        own, best = max(pairs, key=lambda each: each[0].whole / each[1].whole)
        return own.in_flight / best.in_flight, own.after_arrival / best.after_arrival

    def _pairs(self, plan: Trajectory, led: LedError) -> Iterator[tuple[LedError, LedError]]:
        """Yield errors of the motion, and of a rival, at equal duration."""
        for duration, rival in self._rivals:
            slower = duration > (1.0 + MIN_SLOWDOWN) * plan.duration
            beaten = led.in_flight <= rival.in_flight and led.after_arrival <= rival.after_arrival
            # A slower rival that is better in no phase would be beaten by more.
            fair = not slower or beaten
            yield led if fair else self.of_plan(plan.scaled_to(duration)), rival

    def of_plan(self, plan: Trajectory) -> LedError:
        """Return the errors of a motion of the links, led ideally."""
        problem = self._run.problem
        return led_error(self._run.arm, plan, problem.uncertainty, problem.servo)
