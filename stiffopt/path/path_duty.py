"""Limits of the duty along a path: the fastest timing, slowed as a whole until they hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from stiffopt.errors import ProblemError
from stiffopt.result.duty import Duty, DutyHistory, DutyLimits, duty_of
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.result.assessment import Assessment
    from stiffopt.robot.robot import Robot

# Slowing beyond which a duty is that of the weight alone, and relative accuracy of the slowing.
_MAX_SLOWING, _SLOWING_ACCURACY = 16.0, 2e-3


def motion_duty(robot: Robot, motion: Assessment) -> Duty:
    """Return the duty of the drives over one motion that is repeated."""
    return duty_of(robot, [DutyHistory.of_motion(motion)])


def describe_duty(robot: Robot, motion: Assessment) -> str:
    """Return the duty of a motion as a note."""
    duty = motion_duty(robot, motion)
    loaded = duty.most_loaded
    unit = joint_unit("N m", loaded.prismatic)
    told = (
        f"Repeated without a pause, the motion takes {duty.energy:.4g} J of work from the drives, "
        f"with an rms torque of {loaded.rms_torque:.4g} {unit} in {loaded.name}, "
        f"{loaded.rms_torque / loaded.torque_max:.0%} of its limit"
    )
    shortest = duty.shortest_life
    # A reducer at rest lasts for ever.
    if shortest is None or shortest.life is None or math.isinf(shortest.life):
        return f"{told}."
    return f"{told}; the reducer of {shortest.name} lasts {shortest.life / 3600.0:.3g} h."


def slowing_within_duty(
    robot: Robot, limits: DutyLimits, slowed: Callable[[float], Assessment], most: float
) -> float:
    """Return the least factor on the duration of a timing at which its duty keeps the limits.

    `slowed` is the motion at a factor, `most` the largest that the problem's duration allows.
    Raises `ProblemError` with the value of a limit that no allowed factor keeps.
    """

    def excess(factor: float) -> list[str]:
        uses = limits.uses(motion_duty(robot, slowed(factor)))
        return [use.text for use in sorted(uses, key=lambda use: -use.share) if use.share > 1.0]

    over = excess(1.0)
    if not over:
        return 1.0
    low, high = 1.0, min(most, _MAX_SLOWING)
    if high > 1.0:
        over = excess(high)
    if over:
        why = (
            "at motion.duration, its upper bound" if high == most else "however slow the motion is"
        )
        raise ProblemError(
            f"{over[0]} {why}. Raise that limit, allow more time, or change posture or payload."
        )
    while high / low - 1.0 > _SLOWING_ACCURACY:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if excess(middle) else (low, middle)
    return high
