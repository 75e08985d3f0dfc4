"""Joint spline along a curve, with knots where the curve bends."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.result.joint_path import JointPath

# Shares of the interval between two knots at which the error is measured.
_CHECKED_SHARES = (0.25, 0.5, 0.75)
MAX_KNOTS = 30_000

Curve = Callable[[np.ndarray], np.ndarray]


def fit_joint_path(
    curve: Curve,
    breaks: np.ndarray,
    error: Callable[[np.ndarray, np.ndarray], np.ndarray],
    tolerance: float,
) -> tuple[JointPath, float]:
    """Fit a cubic spline to a curve; knots are inserted where its error exceeds the tolerance.

    `curve` gives joint positions (K, n) at parameters (K,) from 0 to 1, with knots at `breaks`;
    `error` (K,) is that of joint positions which stand for it. Returns the path and its largest
    error; raises `ProblemError` where more than `MAX_KNOTS` knots would be needed.
    """
    # Intervals of a piece in the first round.
    steps = np.linspace(0.0, 1.0, 4, endpoint=False)
    knots = np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * steps).ravel(), breaks[-1])
    points = curve(knots)
    for _ in range(40):
        path, span = JointPath.at_knots(knots, points), np.diff(knots)
        at = (knots[:-1, None] + span[:, None] * np.array(_CHECKED_SHARES)).ravel()
        worst = error(path(at), at).reshape(len(span), -1).max(axis=1)
        wide = worst > tolerance
        if not wide.any():
            return path, float(worst.max())
        # Halved, an interval must not be far shorter than its neighbours.
        least = np.where(wide, 0.5 * span, span)
        near = np.minimum(np.append(least[1:], np.inf), np.append(np.inf, least[:-1]))
        # Largest ratio of neighbouring intervals: a spline oscillates between very uneven ones.
        wide |= span > 8.0 * near
        new = 0.5 * (knots[:-1] + knots[1:])[wide]
        if len(knots) + len(new) > MAX_KNOTS:
            break
        order = np.argsort(np.concatenate([knots, new]), kind="stable")
        points = np.concatenate([points, curve(new)])[order]
        knots = np.concatenate([knots, new])[order]
    raise ProblemError(
        f"a joint spline with {len(knots)} knots follows the path within {worst.max():.3g} only; "
        f"asked is {tolerance:.3g}. Give a larger tolerance, or smooth the path."
    )
