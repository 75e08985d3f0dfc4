"""Motors of planned links, changed a little so that the true springs let the links do the plan.

The law by which motors lead their links has its corners rounded off, as wide as the motors' jerk
needs (`solver.corners`). What that leaves out pushes the links: an arm with reducers that are soft
about zero torque swings on after arrival by a fifth of its deviation in flight. Little is needed
against it, as pushes in time with a swing add up: some of the jerk that the motion does not use.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from stiffopt.certificate.assess import assess
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.solver.motor_change import changed_motors

if TYPE_CHECKING:
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.result.simulation import SimulatedMotion
    from stiffopt.result.trajectory import Trajectory

# Changes so often at most, until the simulated motion is this near to the plan, as a share of its
# peak, or comes no nearer than to this share of before. The first may lead past a corner of the
# stiffness at another speed, behind which the answer was not linear: the second knows it. Where a
# limit is exceeded yet, as many as twice: behind wide corners each takes away a third.
_ROUNDS, _NEAR, _NEARER = 4, 3e-2, 0.9
_FIRST = 1
# What the tool after arrival counts for more at most: beyond, nothing holds the links in flight.
_MOST_AFTER = 30.0
# A deviation as good as none [m].
_NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class Calmed:
    """A motion of the motors with its certificate, and what the arm does with it.

    Parameters
    ----------
    motors : Trajectory
    assessment : Assessment
    simulated : SimulatedMotion
    """

    motors: Trajectory
    assessment: Assessment
    simulated: SimulatedMotion

    @classmethod
    def of(cls, problem: TrajectoryProblem, arm: ElasticArm, motors: Trajectory) -> Calmed:
        """Judged and simulated."""
        return cls(motors, assess(problem, motors), simulate(arm, MotorMotion.of(motors)))

    @cached_property
    def planned(self) -> float:
        """Peak of the planned deviation [m]."""
        return max(self.assessment.deflection_summary()["dynamic"].peak, _NOTHING)

    @property
    def off(self) -> float:
        """How far the arm is from the plan, in flight and after arrival, over the plan's peak."""
        after = self.simulated.peak_after or 0.0
        return (abs(self.simulated.peak - self.planned) + after) / self.planned

    def overshoot(self, problem: TrajectoryProblem) -> float:
        """Share by which the arm goes too far after arrival for the problem's limits; 0 if none."""
        limits, swing = problem.active_limits, self.assessment.simulated
        if swing is None or swing.peak_after is None:
            return 0.0
        beyond = [each.overshoot(limits, swing) for each in limits.kinds if each.of_arrival]
        return max([0.0, *beyond])

    @property
    def reach(self) -> float:
        """How far the tool goes in flight and after arrival together [m]."""
        return self.simulated.peak + (self.simulated.peak_after or 0.0)


def calmed(
    problem: TrajectoryProblem, arm: ElasticArm, motors: Trajectory, tolerance: float
) -> Calmed:
    """Motors whose links come nearest to their plan; the same where no change is of use.

    Parameters
    ----------
    problem : TrajectoryProblem
    arm : ElasticArm
    motors : Trajectory
        Of planned links that are at rest at both ends.
    tolerance : float
        Share of a limit that may be exceeded.

    Raises
    ------
    NotSimulatedError
        The arm cannot be simulated.
    """
    last = found = Calmed.of(problem, arm, motors)
    kept, after = found.assessment.feasible(tolerance), 1.0
    for attempt in range(1, 2 * _ROUNDS + 1):
        if kept and (found.off <= _NEAR or attempt > _ROUNDS):
            break
        # A limit after arrival asks for more, the longer it is exceeded the more there.
        beyond = 1.0 + last.overshoot(problem)
        after = min(after * beyond, _MOST_AFTER)
        near = _NEAR * last.planned / beyond
        changed = changed_motors(
            problem, arm, last.motors, last.assessment, last.simulated, near, after
        )
        # What is not linear is met by simulating, and changing it again.
        before, last = last, Calmed.of(problem, arm, changed)
        if last.assessment.feasible(tolerance) and (last.off < found.off or not kept):
            found, kept = last, True
        if kept and attempt > _FIRST and last.off > _NEARER * before.off:
            break
    return found
