"""Smoothing width of the motor law, as wide as the motors' limits need.

Motors that lead links pass kinks of the joints' stiffness. At a kink their speed changes within a
torque range of the smoothing width. Passed fast, a narrow one needs hundreds of times a motor's
jerk limit, however smooth the links' motion is; twice the width needs a quarter of it.
"""

from __future__ import annotations

from collections.abc import Callable

from stiffopt.result.trajectory import Trajectory

# The width is doubled up to so often, while that reduces the excess to this share at least.
MAX_DOUBLINGS = 7
MAX_REMAINING_EXCESS = 0.75
# Excess that a solve removes by passing kinks slightly slower.
TOLERABLE_KINK_EXCESS = 1.0
# Excess above which it comes from passing a kink of a joint's stiffness too fast.
KINK_EXCESS = 0.25
# Knot spacings of the splines that smooth a motion of the links [s], tried in order.
KNOT_SPACINGS = (0.005, 0.01, 0.02, 0.04)
# Share of the last width that is tried as well: narrower, with less residual vibration.
_INTERMEDIATE_WIDTH = 0.7


def motors_with_sufficient_smoothing(
    motors: Callable[[float], Trajectory],
    excess: Callable[[Trajectory], float],
    smoothing: float,
    allowed: float,
) -> Trajectory:
    """Return motors by the narrowest law with an allowed excess, or by that of the least excess.

    `motors`: motion of the motors for a factor on the law's smoothing widths. `excess`: largest
    relative excess of the motors' limits. `smoothing`: the narrowest factor. `allowed`: excess up
    to which the width is sufficient.
    """
    made: dict[float, tuple[Trajectory, float]] = {}

    def beyond(width: float) -> float:
        own = motors(width)
        made[width] = own, excess(own)
        if len(made) > 2:
            # The width found is the last one or the one before; motions of minutes are large.
            del made[next(iter(made))]
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
    """Return the narrowest factor, by doubling, with an allowed excess, or that of the least one.

    `beyond` gives the excess for a factor on the law's smoothing widths; `smoothing` is the
    narrowest.
    """
    worst = beyond(smoothing)
    for _ in range(MAX_DOUBLINGS):
        if worst <= allowed:
            break
        less = beyond(2.0 * smoothing)
        if less > max(MAX_REMAINING_EXCESS * worst, allowed):
            break
        worst, smoothing = less, 2.0 * smoothing
    return smoothing
