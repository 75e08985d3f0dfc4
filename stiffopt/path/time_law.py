"""Time law s(t) of a path: cubic spline over its nodes, rescaled by x = (dt/dt_new)^2."""

from __future__ import annotations

from math import factorial

import numpy as np
import scipy

from stiffopt.result.trajectory import Trajectory

# Longest step of the grid [s], and least and largest number of steps.
_LONGEST_STEP, _MIN_STEPS, _MAX_STEPS = 5e-3, 200, 12_000
# Least x of a rescaling.
LEAST_SCALE = 1e-3
# Gauss-Legendre points of the time of a step.
_GAUSS_POINTS, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(4)


class TimeLaw:
    """Time law s(t): the cubic spline through values at nodes, from rest to rest.

    `time` and `values` (K + 1,): nodes [s], and s there. `eased`: the acceleration is zero at both
    ends; the values beside the ends are then the spline's.
    """

    def __init__(self, time: np.ndarray, values: np.ndarray, eased: bool) -> None:
        knots = np.concatenate([time[:1].repeat(3), time, time[-1:].repeat(3)])
        sites, rest = np.arange(len(time)), [(1, 0.0)]
        if eased:
            sites, rest = np.delete(sites, [1, len(time) - 2]), [(1, 0.0), (2, 0.0)]
        spline = scipy.interpolate.make_interp_spline(
            time[sites], values[sites], 3, knots, bc_type=(rest, rest)
        )
        self.time, self.eased = time, eased
        # Coefficients (4, K) of the powers of the time since each node, the lowest first.
        self.powers = np.stack([spline(time[:-1], k) / factorial(k) for k in range(4)])
        self.values = np.append(self.powers[0], values[-1])

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.time[-1])

    def at(self, share: float) -> np.ndarray:
        """Return s and three derivatives (4, K) at a share of every step."""
        return _evaluate(self.powers, share * np.diff(self.time))

    def __call__(self, time: np.ndarray) -> np.ndarray:
        """Return s at times (m,)."""
        step = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        return np.asarray(_evaluate(self.powers[:, step], time - self.time[step])[0])

    def trajectory(self) -> Trajectory:
        """Return the law as a motion of one joint, from 0 to 1."""
        _, _, c2, c3 = self.powers
        acceleration = np.stack([2.0 * c2, 6.0 * c3], axis=1)
        return Trajectory.from_acceleration(
            self.time, acceleration[:, :, None], self.powers[0, :1], self.powers[1, :1]
        )

    def crossings(self, knots: np.ndarray) -> np.ndarray:
        """Times (m,) at which s passes knots (m,), by bisection."""
        step = np.clip(np.searchsorted(self.values, knots, side="right") - 1, 0, len(self.time) - 2)
        low, high = self.time[step].copy(), self.time[step + 1].copy()
        begin, powers = low.copy(), self.powers[:, step]
        for _ in range(60):
            middle = 0.5 * (low + high)
            before = _evaluate(powers, middle - begin)[0] < knots
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return high

    def with_nodes_at(self, knots: np.ndarray, least: np.ndarray) -> TimeLaw:
        """Return the law with nodes where s passes knots, and about equal steps between.

        `least` (m - 1,): number of steps between neighbouring knots at least.
        """
        crossed = np.concatenate([[0.0], self.crossings(knots[1:-1]), [self.duration]])
        # Rounding may order crossings of very close knots wrongly.
        crossed = np.maximum.accumulate(crossed)
        spans = np.diff(crossed)
        longest = self.duration / count_steps(self.duration)
        counts = np.maximum(np.ceil(spans / longest).astype(int), least)
        counts[[0, -1]] = np.maximum(counts[[0, -1]], 3)
        ends = np.cumsum(counts)
        inside = (np.arange(ends[-1]) - np.repeat(ends - counts, counts)) / np.repeat(
            counts, counts
        )
        time = np.repeat(crossed[:-1], counts) + inside * np.repeat(spans, counts)
        time = np.append(time, self.duration)
        values = self(time)
        values[np.append(0, ends)] = knots
        return TimeLaw(time, values, self.eased)


def _evaluate(powers: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Cubic polynomials and three derivatives (4, K) at local times (K,)."""
    c0, c1, c2, c3 = powers
    return np.stack(
        [
            c0 + local * (c1 + local * (c2 + local * c3)),
            c1 + local * (2.0 * c2 + local * 3.0 * c3),
            2.0 * c2 + 6.0 * local * c3,
            6.0 * c3 + 0.0 * local,
        ]
    )


def count_steps(duration: float) -> int:
    """Return the number of steps of a law of a duration [s]."""
    return int(np.clip(np.ceil(duration / _LONGEST_STEP), _MIN_STEPS, _MAX_STEPS))


def basis_of(time: np.ndarray, share: float) -> np.ndarray:
    """Quadratic B-splines on nodes with two derivatives, (3, K, 3): those of every step."""
    h = np.diff(time)
    before, after = np.append(0.0, h[:-1]), np.append(h[1:], 0.0)
    up, down = share * h, (1.0 - share) * h
    first, last = 1.0 / (h * (h + before)), 1.0 / (h * (h + after))
    value = np.stack([down**2 * first, up**2 * last], axis=1)
    slope = np.stack([-2.0 * down * first, 2.0 * up * last], axis=1)
    bend = np.stack([2.0 * first, 2.0 * last], axis=1)
    full = []
    for part, whole in ((value, 1.0), (slope, 0.0), (bend, 0.0)):
        middle = whole - part.sum(axis=1)
        full.append(np.stack([part[:, 0], middle, part[:, 1]], axis=1))
    return np.stack(full)


def time_scaled(law: TimeLaw, x: np.ndarray) -> TimeLaw:
    """Return the law with its time rescaled by the B-spline coefficients x (K + 2,)."""
    h = np.diff(law.time)
    near = np.stack([x[k : k + len(h)] for k in range(3)], axis=1)
    spent = np.zeros_like(h)
    for point, weight in zip(_GAUSS_POINTS, _GAUSS_WEIGHTS, strict=True):
        value = np.sum(basis_of(law.time, 0.5 * (1.0 + point))[0] * near, axis=1)
        spent += 0.5 * weight * h / np.sqrt(np.maximum(value, LEAST_SCALE))
    return TimeLaw(np.concatenate([[0.0], np.cumsum(spent)]), law.values, law.eased)


def average_speed(
    time: np.ndarray, s: np.ndarray, rate: np.ndarray, window: float
) -> tuple[np.ndarray, np.ndarray]:
    """Average a speed profile, linear between times, over a window [s]; return times and s."""
    whole = time[-1] + window
    grid = np.linspace(0.0, whole, 4 * count_steps(whole) + 1)
    span = np.diff(time)
    area = s[:-1] * span + rate[:-1] * span**2 / 2.0 + np.diff(rate) * span**2 / 6.0
    area = np.concatenate([[0.0], np.cumsum(area)])

    def integral(at: np.ndarray) -> np.ndarray:
        """Integral of s over time, at rest before and after."""
        inner = np.clip(at, 0.0, time[-1])
        k = np.clip(np.searchsorted(time, inner, side="right") - 1, 0, len(span) - 1)
        local = inner - time[k]
        bend = (rate[k + 1] - rate[k]) / span[k]
        found = area[k] + local * (s[k] + local * (rate[k] / 2.0 + local * bend / 6.0))
        return np.asarray(found + np.maximum(at - time[-1], 0.0) * s[-1])

    return grid, (integral(grid) - integral(grid - window)) / window
