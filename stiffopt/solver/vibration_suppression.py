"""Residual vibration suppression: a small change of the motors' motion, found by simulation.

The motor law is smoothed as widely as the motors' jerk limit needs (`command.smoothing_width`). The
smoothing error excites the links: an arm with reducers that are soft about zero torque has residual
vibration of a fifth of its deviation in flight. A small change (`command.motor_change`) suppresses
it, since excitation in phase with a mode accumulates: it uses jerk that the motion leaves unused.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from stiffopt.certificate.assess import assess
from stiffopt.command.motor_change import change_motors
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.exchange import Oracle, Proposal, Rank, exchange

if TYPE_CHECKING:
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.result.simulation import SimulatedMotion
    from stiffopt.solver.solve_run import SolveRun

# Changes: most in a row, deviation from the plan over its peak at which they end, and share of the
# deviation above which a further one is not worth it. The first one is always followed by a second,
# since it may pass a kink of the stiffness where the response was not linear. While a limit is
# exceeded twice as many are made: with a wide smoothing each removes a third of the excess.
_MAX_CHANGES, _TARGET_DEVIATION, _MAX_REMAINING_DEVIATION = 4, 3e-2, 0.9
# Largest weight of the tool after arrival: beyond, the links in flight are not controlled.
_MAX_ARRIVAL_WEIGHT = 30.0
# Deviation that counts as zero [m].
_NEGLIGIBLE_DEVIATION = 1e-9


@dataclass(frozen=True, eq=False)
class SimulatedMotors:
    """Motion of the motors with its certificate and its elastic simulation."""

    motors: Trajectory
    assessment: Assessment
    simulated: SimulatedMotion

    @classmethod
    def of(cls, arm: ElasticArm, motors: Trajectory, assessment: Assessment) -> SimulatedMotors:
        """Simulate a certified motion of the motors."""
        return cls(motors, assessment, simulate(arm, MotorMotion.of(motors)))

    @cached_property
    def planned(self) -> float:
        """Peak of the planned deviation [m]."""
        return max(self.assessment.deflection_summary()["dynamic"].peak, _NEGLIGIBLE_DEVIATION)

    @property
    def off(self) -> float:
        """Deviation from the plan, in flight and after arrival, over the plan's peak [-]."""
        after = self.simulated.peak_after or 0.0
        return (abs(self.simulated.peak - self.planned) + after) / self.planned

    def overshoot(self, problem: TrajectoryProblem) -> float:
        """Return the relative excess of the problem's limits after arrival; 0 without one."""
        limits, swing = problem.active_limits, self.assessment.simulated
        if swing is None or swing.peak_after is None:
            return 0.0
        beyond = [each.overshoot(limits, swing) for each in limits.kinds if each.of_arrival]
        return max([0.0, *beyond])

    @property
    def reach(self) -> float:
        """Sum of the tool's peaks in flight and after arrival [m]."""
        return self.simulated.peak + (self.simulated.peak_after or 0.0)


def suppress_vibration(
    run: SolveRun, arm: ElasticArm, start: SimulatedMotors, tolerance: float
) -> SimulatedMotors:
    """Return motors whose links follow their plan most closely, unchanged where no change helps.

    `start` is of planned links at rest at both ends, `tolerance` the allowed relative excess of
    limits. Raises `NotSimulatedError`.
    """
    return exchange(run, MotorChanges(run.problem, arm, start, tolerance), start)


class MotorChanges(Oracle[SimulatedMotors]):
    """Small changes of the motors, each from the simulation of the last: the arm is not linear."""

    step = "vibration suppression"

    def __init__(
        self, problem: TrajectoryProblem, arm: ElasticArm, start: SimulatedMotors, tolerance: float
    ) -> None:
        self._problem, self._arm, self._tolerance = problem, arm, tolerance
        self._best = self._before = start
        self._arrival_weight = 1.0
        self.rounds = 2 * _MAX_CHANGES

    def rank(self, found: SimulatedMotors) -> Rank:
        """Return the rank by the limits, then by the deviation from the plan."""
        kept = found.assessment.feasible(self._tolerance)
        return (0.0, found.off) if kept else (1.0, 0.0)

    def accepts(self, found: SimulatedMotors, best: SimulatedMotors) -> bool:
        """Return True for motors that keep all limits and are nearer to the plan, or the first."""
        better = self.rank(found) < self.rank(best)
        self._best = found if better else best
        return better

    def propose(self, last: SimulatedMotors, number: int) -> Proposal[SimulatedMotors] | None:
        """Return the motors with another change; None near the plan, or without much gain."""
        exceeded, off = self.rank(self._best)
        if not exceeded and (
            off <= _TARGET_DEVIATION
            or number >= _MAX_CHANGES
            or (number > 1 and last.off > _MAX_REMAINING_DEVIATION * self._before.off)
        ):
            return None
        # While a limit after arrival is exceeded its weight grows from change to change.
        beyond = 1.0 + last.overshoot(self._problem)
        after = self._arrival_weight = min(self._arrival_weight * beyond, _MAX_ARRIVAL_WEIGHT)
        near = _TARGET_DEVIATION * last.planned / beyond
        self._before = last

        def change() -> SimulatedMotors:
            motors = change_motors(
                self._problem, self._arm, last.motors, last.assessment, last.simulated, near, after
            )
            assessment = assess(self._problem, motors, led=last.assessment.led)
            return SimulatedMotors.of(self._arm, motors, assessment)

        return Proposal(f"the tool leaves its plan by {last.off:.1%} of the peak", change)
