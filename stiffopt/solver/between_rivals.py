"""Motions between the optimised one and its rivals, judged by simulated worst arms.

The optimiser's ringing is an estimate up to a factor, and in flight it is not in the rows at all. A
rival's smooth time law hardly rings and has its largest error elsewhere. The worst error is nearly
convex in the motion, as are the limits of the joints: between two motions of about the same error
there is a better one, and none is worse than the rival of its duration.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.command.command_search import CommandOnArms
from stiffopt.command.compensation import rival_commands
from stiffopt.command.simulation import elastic_arm, rival_motions
from stiffopt.elastic.led_error import led_error
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.errors import NotSimulatedError
from stiffopt.result.tool_error import LedError
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.arrival import suppress_vibration_of_links
from stiffopt.solver.exchange import OutcomeOracle, Proposal, Rank
from stiffopt.solver.programme import Outcome, follow_plan
from stiffopt.solver.solve_run import SolveRun

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
        self._best: LedError | None = None
        if not any(each.kind.of_uncertain_arms for each in run.problem.objectives):
            return
        duration = outcome.assessment.duration
        with suppress(NotSimulatedError):
            arm = elastic_arm(run.problem, run.motion.start)
            motions = rival_motions(run.problem, run.motion, duration)
            found = rival_commands(run.problem, arm, motions, run.motors)
            run.rivals = duration, motions, found
            kept = [each for each in found if not each.excess]
            best = min(kept, key=lambda each: each.worst_case_peaks, default=None)
            if best is not None:
                # By an ideal lead too, as the motions beside it.
                own = _smooth_rival(best, float(best.motion.time[-1]))
                self._best = self._led_error(own)
            # Others pass vias at other instants, or reach other ends.
            if run.motion.start_fixed and run.motion.end_fixed and not len(run.motion.vias):
                self._rivals = {
                    each.motion.name: _smooth_rival(each, outcome.planned.duration) for each in kept
                }

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return the motion of least worst error on the lines to the rivals."""
        if last.assessment.led is None or not last.raw.converged:
            return None
        tried = [
            (self._led_error(plan), plan, f"{100 * share:.0f} % of the {name} motion")
            for name, rival in self._rivals.items()
            for share in _RIVAL_SHARES
            for plan in (last.planned.mixed_with(rival, share),)
        ]
        if not tried:
            return None
        led, plan, text = min(tried, key=lambda each: self._worse(each[0]))
        if self._worse(led) >= self._worse(last.assessment.led):
            return None
        ratio = led.whole / last.assessment.led.whole
        reason = f"with {text} the worst arm has {ratio:.2f} times the error"
        return Proposal(reason, lambda: self._follow(last, plan, led))

    def rank(self, found: Outcome) -> Rank:
        """Return the rank with the excess over the best rival before the objective."""
        excess, late, _ = super().rank(found)
        led = found.assessment.led
        return excess, late, *((np.inf,) if led is None else self._worse(led))

    def accepts(self, found: Outcome, best: Outcome) -> bool:
        """Return True for a better motion that collides with nothing new."""
        return super().accepts(found, best) and (not found.collisions or bool(best.collisions))

    def _worse(self, led: LedError) -> Rank:
        """Return the error over the best rival's, of the phase that is worse, and its sum."""
        best = self._best
        if best is None or not min(best.in_flight, best.after_arrival) > 0.0:
            return 1.0, led.whole
        flight, after = led.in_flight / best.in_flight, led.after_arrival / best.after_arrival
        return max(flight, after, 1.0), led.whole

    def _led_error(self, plan: Trajectory) -> LedError:
        problem = self.run.problem
        return led_error(self.run.arm, plan, problem.uncertainty, problem.servo)

    def _follow(self, last: Outcome, plan: Trajectory, led: LedError) -> Outcome:
        motors = follow_plan(self.run, plan, last.smoothing.law)
        assessment = assess(self.run.problem, motors, led=led)
        found = replace(last, planned=plan, trajectory=motors, assessment=assessment, arm=None)
        return suppress_vibration_of_links(self.run, found)


def _smooth_rival(rival: CommandOnArms, duration: float) -> Trajectory:
    """Return the links' motion of a rival's command at a duration [s]."""
    assert rival.motion.rival is not None
    assert rival.spacing is not None
    return smooth_motion(rival.motion.rival.at(duration), rival.spacing)
