"""What a motion leaves after arrival where the damping that the model assumes is another.

Nobody knows a damping that no file states. Where it is another, a short motion rings by what its
wind-up holds at the modes' frequencies. No motion is slowed for that (decision 0027): it is said.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import simulate
from stiffopt.errors import relative
from stiffopt.problem.limit import LIMITS

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.assessment import Assessment

# Times what is assumed: 1 and 3 % of critical.
_FACTORS = (0.5, 1.5)


def exceeded_otherwise(problem: TrajectoryProblem, motion: Assessment) -> dict[str, float]:
    """Limits of the swing after arrival that arms of other damping exceed, by their size over it.

    Empty where the problem has none, or every joint states its damping.

    Raises
    ------
    NotSimulatedError
        The arm cannot be simulated.
    """
    if motion.swing is None or motion.swing.peak_after is None:
        return {}
    limits = problem.active_limits
    kinds = [each for each in limits.kinds if LIMITS[each.name].of_arrival]
    arm = ElasticArm(problem.robot, motion.position[0], problem.process_force)
    if not (kinds and arm.assumed_damping):
        return {}
    command = MotorMotion(motion.time, motion.position, motion.velocity)
    found: dict[str, float] = {}
    for factor in _FACTORS:
        swing = simulate(arm.scale_assumed_damping(factor), command, band=limits.settling_band)
        for kind in kinds:
            over = LIMITS[kind.name].overshoot(limits, swing)
            if over > max(found.get(kind.name, 0.0), 0.0):
                found[kind.name] = over
    return found


def other_damping_note(problem: TrajectoryProblem, motion: Assessment) -> str:
    """What is to be said of limits that hold by the assumed damping alone; "" where all hold."""
    found = exceeded_otherwise(problem, motion)
    if not found:
        return ""
    listed = " and ".join(f"what {name} allows by {relative(over)}" for name, over in found.items())
    return (
        "Limits after arrival hold with the damping that is assumed. With half of it, or half as "
        f"much again, the tool's swing exceeds {listed}: state the joints' measured damping in the "
        "robot file, or a lower limit."
    )
