"""Geometric joint path, and exact piecewise-polynomial motions along it.

The path is cubic in its parameter s between knots, a time law s(t) polynomial in t between breaks;
the motion q(s(t)) is polynomial between the knots and breaks of both.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from stiffopt.errors import ProblemError
from stiffopt.result.trajectory import Trajectory

# Distance of a knot from a break of a law, over the law's step, below which they are one instant.
_SAME_PLACE_SHARE = 1e-4


@dataclass(frozen=True)
class JointPath:
    """Spline path through waypoints, with the parameter s from 0 to 1."""

    knots: np.ndarray  # (m,) path parameter of the waypoints, from 0 to 1
    # (m - 1, 4, n) coefficient j of piece k multiplies (s - knots[k])**j [rad] or [m].
    coefficients: np.ndarray
    # (m - 1,) largest tool speed on each piece [m/s]; None for no limit.
    speeds: np.ndarray | None = None
    # (k,) inner knots at which every motion rests; the path may have corners there.
    stops: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    dwells: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (k,) rests there [s]
    # (c, 3) corners that the tool's path was programmed with, blended or stopped at [m].
    corners: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def through(cls, waypoints: ArrayLike, spacing: str = "uniform") -> JointPath:
        """Straight line through two waypoints, not-a-knot cubic spline through more.

        `waypoints` (m, n): start, via points, end; neighbours must differ [rad] or [m]. `spacing`:
        distances of the waypoints in s: "uniform", or "chord" for distances in joint space, which
        avoids overshoot of the spline between very uneven waypoints.
        """
        points = np.atleast_2d(np.asarray(waypoints, dtype=float))
        length = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if len(points) < 2 or not np.all(length > 0):
            same = np.flatnonzero(~(length > 0))
            found = f"; the arm does not move from number {same[0] + 1} on" if len(same) else ""
            raise ProblemError(
                "a path needs at least two waypoints, start and end included, each different from "
                f"the one before{found}. Give another start, via point or end."
            )
        if spacing not in ("uniform", "chord"):
            raise ProblemError(f"spacing = {spacing!r} is unknown. Allowed: chord, uniform.")
        steps = length if spacing == "chord" else np.ones_like(length)
        knots = np.concatenate([[0.0], np.cumsum(steps) / np.sum(steps)])
        knots[-1] = 1.0
        return cls.at_knots(knots, points)

    @classmethod
    def at_knots(cls, knots: np.ndarray, points: np.ndarray) -> JointPath:
        """Not-a-knot cubic spline with points (m, n) at knots (m,) from 0 to 1."""
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(knots, points, bc_type="not-a-knot")
        # SciPy stores the highest power first and the piece second.
        return cls(knots, np.ascontiguousarray(spline.c[::-1].transpose(1, 0, 2)))

    @property
    def points(self) -> np.ndarray:
        """Joint positions (m, n) at the knots."""
        return self(self.knots)

    def between_stops(self) -> list[tuple[float, float, JointPath]]:
        """Return begin and end of each part between stops, and its path with s from 0 to 1."""
        ends = [0, *self.stops.tolist(), len(self.knots) - 1]
        parts = []
        for first, last in pairwise(ends):
            begin, span = self.knots[first], self.knots[last] - self.knots[first]
            own = slice(first, last)
            path = JointPath(
                np.append((self.knots[own] - begin) / span, 1.0),
                self.coefficients[own] * span ** np.arange(4)[None, :, None],
                None if self.speeds is None else self.speeds[own],
            )
            parts.append((float(begin), float(begin + span), path))
        return parts

    @property
    def joints(self) -> int:
        """Number of joints."""
        return int(self.coefficients.shape[2])

    def __call__(self, s: object, order: int = 0) -> np.ndarray:
        """Evaluate position (order 0) or a derivative by s at `s` (k,), shape (k, n)."""
        positions = np.asarray(s, dtype=float)
        return self.evaluate_piece(positions, self.piece_index(positions), order)

    def piece_index(self, s: np.ndarray) -> np.ndarray:
        """Return the pieces (k,) that contain path parameters (k,)."""
        last = len(self.knots) - 2
        return np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, last)

    def evaluate_piece(self, s: np.ndarray, piece: np.ndarray, order: int) -> np.ndarray:
        """Evaluate a derivative (k, n) at `s` (k,) by the polynomials of given pieces (k,)."""
        local = (s - self.knots[piece])[..., None]
        value = np.zeros((*s.shape, self.joints))
        for j in range(3, order - 1, -1):
            factor = factorial(j) // factorial(j - order)
            value = value * local + factor * self.coefficients[piece, j]
        return value

    def follow(self, law: Trajectory) -> Trajectory:
        """Compose the motion q(s(t)) along the path, exact up to rounding.

        `law`: path parameter s as a single joint, from 0 to 1 without reversal.
        """
        times = _merge_crossings(law, self.knots[1:-1])
        begin, middle = times[:-1], 0.5 * (times[:-1] + times[1:])
        piece = self.piece_index(law(middle)[:, 0])
        degree = law.acceleration.shape[1] + 1
        # Local Taylor polynomials: of s about each break, then of q about s at the break.
        s = np.stack([law(begin, j)[:, 0] / factorial(j) for j in range(degree + 1)], axis=1)
        start, s[:, 0] = s[:, 0].copy(), 0.0
        taylor = [self.evaluate_piece(start, piece, j) / factorial(j) for j in range(4)]
        motion = np.zeros((len(begin), 3 * degree + 1, self.joints))
        power = np.ones((len(begin), 1))
        for coefficient in taylor:
            motion[:, : power.shape[1]] += power[:, :, None] * coefficient[:, None, :]
            power = _multiply_polynomials(power, s)
        j = np.arange(2, motion.shape[1])
        acceleration = motion[:, 2:] * (j * (j - 1.0))[:, None]
        return Trajectory.from_acceleration(times, acceleration, motion[0, 0], motion[0, 1])


def _merge_crossings(law: Trajectory, knots: np.ndarray) -> np.ndarray:
    """Merge the breaks of the law with its crossings of the inner knots."""
    breaks = law.times
    at_breaks = law(breaks)[:, 0]
    after = np.clip(np.searchsorted(at_breaks, knots), 1, len(breaks) - 1)
    near = np.minimum(np.abs(at_breaks[after] - knots), np.abs(at_breaks[after - 1] - knots))
    # Closer to a break the knot is passed there: the path's third derivative alone jumps in between
    # and goes with the jerk of the law's own piece. Rounding grows with the number of pieces.
    missed = near >= _SAME_PLACE_SHARE * (at_breaks[after] - at_breaks[after - 1])
    low, high = breaks[after - 1][missed], breaks[after][missed]
    while True:
        middle = 0.5 * (low + high)
        if np.all((middle == low) | (middle == high)):
            return np.union1d(breaks, high)
        before = law(middle)[:, 0] < knots[missed]
        low, high = np.where(before, middle, low), np.where(before, high, middle)


def _multiply_polynomials(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Multiply polynomials (K, p) and (K, r) row by row."""
    result = np.zeros((len(a), a.shape[1] + b.shape[1] - 1))
    for j in range(a.shape[1]):
        result[:, j : j + b.shape[1]] += a[:, j : j + 1] * b
    return result
