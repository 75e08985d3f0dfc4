"""Motions between the optimised one and its rivals, judged by simulated worst arms.

The optimiser's ringing is an estimate up to a factor, and in flight it is not in the rows at all. A
rival's smooth time law hardly rings and has its largest error elsewhere. The worst error is nearly
convex in the motion, as are the limits of the joints: between two motions of about the same error
there is a better one, and none is worse than the rival of its duration.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from stiffopt.certificate.assess import assess, drive_violations, largest_via_miss
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command.command_search import CommandOnArms
from stiffopt.command.compensation import rival_commands
from stiffopt.command.simulation import elastic_arm, rival_motions
from stiffopt.command.smoothing_width import motors_with_sufficient_smoothing
from stiffopt.elastic.led_error import led_error
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.errors import NotSimulatedError
from stiffopt.result.compensation import MIN_SLOWDOWN
from stiffopt.result.tool_error import LedError
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.arrival import suppress_vibration_of_links
from stiffopt.solver.exact_rows import worst_flight_violation
from stiffopt.solver.exchange import OutcomeOracle, Proposal, Rank
from stiffopt.solver.programme import Outcome, follow_plan
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


# Shares of a rival that are tried: the error is flat about the best one.
_RIVAL_SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)


class BetweenRivals(OutcomeOracle):
    """Worst errors of motions on the straight line to a rival, in the space of motions."""

    step = "motions between the optimised one and its rivals"
    # The second one goes from the first to another rival, or further.
    rounds = 2
    explores = False

    def __init__(self, run: SolveRun, outcome: Outcome) -> None:
        super().__init__(run)
        self._rivals: dict[str, Trajectory] = {}
        self._errors = RivalErrors(run, [])
        self._reason = ""
        kept = [] if run.rivals is None else [each for each in run.rivals[2] if not each.excess]
        if not (kept and run.motion.start_fixed and run.motion.end_fixed):
            return
        # By an ideal lead too, as the motions beside them.
        led = [self._errors.of_plan(_smooth_rival(each, each.motion.duration)) for each in kept]
        durations = [each.motion.duration for each in kept]
        self._errors = RivalErrors(run, list(zip(durations, led, strict=True)))
        self._rivals = {
            each.motion.name: _smooth_rival(each, outcome.planned.duration) for each in kept
        }

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return the motion of least worst error on the lines to the rivals."""
        if last.assessment.led is None or not last.raw.converged:
            return None
        own = self._worse(last.planned, last.assessment.led)
        tried = [
            (self._worse(plan, below=own), plan, f"{100 * share:.0f} % of the {name} motion")
            for name, rival in self._rivals.items()
            for share in _RIVAL_SHARES
            for plan in (last.planned.mixed_with(rival, share),)
            if largest_via_miss(self.run.problem, plan) <= CERTIFICATE_TOLERANCE
        ]
        better = [each for each in tried if each[0] < own]
        for worse, plan, text in sorted(better, key=lambda each: each[0]):
            # The smoothness of a rival's command belongs to its own width.
            motors = motors_with_sufficient_smoothing(
                functools.partial(follow_plan, self.run, plan),
                self._excess,
                last.smoothing.law,
                CERTIFICATE_TOLERANCE,
            )
            # Much cheaper than the certificate.
            if self._excess(motors) > CERTIFICATE_TOLERANCE:
                continue
            assessment = assess(self.run.problem, motors)
            if worst_flight_violation(assessment) <= CERTIFICATE_TOLERANCE:
                found = replace(
                    last, planned=plan, trajectory=motors, assessment=assessment, arm=None
                )
                change = f"{worse[-1] / own[-1]:.2f} times the error"
                if worse[0] < own[0]:
                    # Ranked first; the sum of both phases may grow.
                    change = f"{worse[0]:.2f} times a rival's error in place of {own[0]:.2f}"
                self._reason = f"with {text} the worst arm has {change}"
                return Proposal(
                    self._reason, functools.partial(suppress_vibration_of_links, self.run, found)
                )
        return None

    def _excess(self, motors: Trajectory) -> float:
        return drive_violations(self.run.problem, motors)[0].value

    def rank(self, found: Outcome) -> Rank:
        """Return the rank with the excess over the best rival before the objective."""
        excess, late, _ = super().rank(found)
        led = found.assessment.led
        return excess, late, *((np.inf,) if led is None else self._worse(found.planned, led))

    def accepts(self, found: Outcome, best: Outcome) -> bool:
        """Return True for a better motion that collides with nothing new."""
        better = super().accepts(found, best) and (not found.collisions or bool(best.collisions))
        if better:
            self.run.notes.append(f"Moved toward a rival after the optimum: {self._reason}.")
        return better

    def _worse(
        self, plan: Trajectory, led: LedError | None = None, below: Rank = (np.inf, np.inf)
    ) -> Rank:
        """Return the largest error over the best rival's, and the sum of both phases.

        Of a motion that is not `below` another rank, one that is not below it either.
        """
        # Where no error is above a rival's, the sum of both phases decides.
        led = led or self._errors.of_plan(plan, below[1] if below[0] == 1.0 else np.inf)
        if (1.0, led.whole) >= below:
            return below
        return max(*self._errors.ratios(plan, led, below[0]), 1.0), led.whole


def _smooth_rival(rival: CommandOnArms, duration: float) -> Trajectory:
    """Return the links' motion of a rival's command at a duration [s]."""
    assert rival.motion.at is not None
    assert rival.spacing is not None
    return smooth_motion(rival.motion.at(duration), rival.spacing)
