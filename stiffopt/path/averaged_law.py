"""Averages of a time law: the same path, with rates smooth enough for motors that lead.

The motors' jerk contains the fifth derivative of the links' motion. Averaged twice over a window, a
law with continuous acceleration has a continuous fourth derivative; it ends two windows later, and
no rate exceeds its former largest value.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.result.trajectory import Trajectory

# Steps of a window between nodes of the averaged law.
_STEPS_PER_WINDOW = 12
_GAUSS_POINTS, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(4)


def averaged_law(law: Trajectory, window: float) -> Trajectory:
    """Return the average of a law s(t), from rest to rest, taken twice over a window [s]."""
    # The window is slightly shortened, so that nodes meet the end of the law.
    steps = int(np.ceil(law.duration * _STEPS_PER_WINDOW / window))
    h = law.duration / steps
    window, count = h * _STEPS_PER_WINDOW, steps + 2 * _STEPS_PER_WINDOW
    time = h * np.arange(count + 1)
    start, end = law.q0[0], law(np.array([law.duration]))[0, 0]

    def value(t: np.ndarray, order: int) -> np.ndarray:
        inside = (t >= 0.0) & (t <= law.duration)
        found = np.where(t > law.duration, end, start) if order == 0 else np.zeros_like(t)
        found[inside] = law(t[inside], order)[:, 0]
        return found

    first, second = np.zeros(count + 1), np.zeros(count + 1)
    for point, weight in zip(_GAUSS_POINTS, _GAUSS_WEIGHTS, strict=True):
        share = 0.5 * (1.0 + point)
        own = 0.5 * weight * h * (value(time[:-1] + share * h, 0) - start)
        first[1:] += own
        # The double integral over a step, about its end.
        second[1:] += (1.0 - share) * h * own
    first = np.cumsum(first)
    second = np.cumsum(second + h * np.append(0.0, first[:-1]))

    def difference(samples: np.ndarray) -> np.ndarray:
        """Second difference over the window, at rest before the start."""
        before = np.concatenate([np.zeros(2 * _STEPS_PER_WINDOW), samples])
        late = (
            before[2 * _STEPS_PER_WINDOW :]
            - 2.0 * before[_STEPS_PER_WINDOW:-_STEPS_PER_WINDOW]
            + before[: -2 * _STEPS_PER_WINDOW]
        )
        return np.asarray(late / window**2)

    derivatives = np.stack(
        [
            start + difference(second),
            difference(first),
            difference(value(time, 0) - start),
            difference(value(time, 1)),
        ]
    )
    derivatives[0, -1] = end
    derivatives[1:, -1] = 0.0
    return replace(Trajectory.through(time, derivatives[:, :, None], law), link=None)
