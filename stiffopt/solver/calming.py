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
# stiffness at another speed, behind which the answer was not linear: the second knows it.
_ROUNDS, _NEAR, _NEARER = 4, 3e-2, 0.9
_FIRST = 1
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
    kept = found.assessment.feasible(tolerance)
    for attempt in range(1, _ROUNDS + 1):
        if kept and found.off <= _NEAR:
            break
        # A limit of the swing after arrival may ask for more.
        near = _NEAR * last.planned / (1.0 + max(last.assessment.worst_violation.value, 0.0))
        changed = changed_motors(problem, arm, last.motors, last.assessment, last.simulated, near)
        # What is not linear is met by simulating, and changing it again.
        before, last = last, Calmed.of(problem, arm, changed)
        if last.assessment.feasible(tolerance) and (last.off < found.off or not kept):
            found, kept = last, True
        if attempt > _FIRST and last.off > _NEARER * before.off:
            break
    return found
