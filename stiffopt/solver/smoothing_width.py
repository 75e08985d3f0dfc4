"""Corners of a joint's stiffness, passed by motors that lead links: as wide as their limits need.

At a corner of the law the motors' speed bends within as much torque as the corner is wide. Passed
fast, a narrow one asks for hundreds of times a motor's jerk, however smooth the links' motion is;
twice the width asks for a quarter of it.
"""

from __future__ import annotations

from collections.abc import Callable

from stiffopt.result.trajectory import Trajectory

# Widths are doubled up to so often, while that lowers the excess to this share at least.
_MAX_DOUBLINGS = 7
MAX_REMAINING_EXCESS = 0.75
# Excess that a solve gets rid of by passing corners a little slower.
TOLERABLE_KINK_EXCESS = 1.0
# Of the last width: what may do as well, and leaves less after arrival.
_INTERMEDIATE_WIDTH = 0.7


def motors_with_sufficient_smoothing(
    motors: Callable[[float], Trajectory],
    excess: Callable[[Trajectory], float],
    smoothing: float,
    allowed: float,
) -> Trajectory:
    """Motors by the narrowest law whose excess is allowed, or by that of the least excess.

    Parameters
    ----------
    motors : callable
        Motion of the motors for a factor on the law's smoothing widths.
    excess : callable
        By what share a motion exceeds a limit of the motors, at worst.
    smoothing : float
        The narrowest factor.
    allowed : float
        Share up to which nothing is wider.
    """
    made: dict[float, tuple[Trajectory, float]] = {}

    def beyond(width: float) -> float:
        own = motors(width)
        made[width] = own, excess(own)
        return made[width][1]

    width = narrowest_sufficient_width(beyond, smoothing, allowed)
    found, worst = made[width]
    if width > smoothing and worst <= allowed:
        between = motors(_INTERMEDIATE_WIDTH * width)
        return between if excess(between) <= allowed else found
    return found


def narrowest_sufficient_width(
    beyond: Callable[[float], float], smoothing: float, allowed: float
) -> float:
    """The narrowest factor, by doubling, whose excess is allowed, or that of the least excess.

    Parameters
    ----------
    beyond : callable
        Excess for a factor on the law's smoothing widths.
    smoothing : float
        The narrowest factor.
    allowed : float
    """
    worst = beyond(smoothing)
    for _ in range(_MAX_DOUBLINGS):
        if worst <= allowed:
            break
        less = beyond(2.0 * smoothing)
        if less > max(MAX_REMAINING_EXCESS * worst, allowed):
            break
        worst, smoothing = less, 2.0 * smoothing
    return smoothing
