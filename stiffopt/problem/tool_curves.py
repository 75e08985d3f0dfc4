"""Curves of a tool path by arc length: lines, arcs, splines, and the blends between them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from stiffopt.errors import ProblemError

# Intervals of the arc length table of a spline's interval.
_TABLE_STEPS = 16


class ToolCurve(ABC):
    """Curve of the tool point, by the distance along it [m]."""

    length: float

    @abstractmethod
    def at(self, along: np.ndarray) -> np.ndarray:
        """Points (K, 3) [m] at distances (K,) [m]."""

    @abstractmethod
    def end_derivatives(self, end: int) -> tuple[np.ndarray, np.ndarray]:
        """Unit tangent (3,) and curvature vector (3,) [1/m] at the start (0) or the end (-1)."""

    @abstractmethod
    def cut(self, before: float, after: float) -> ToolCurve:
        """Shorten the curve at both ends [m]."""

    def marks(self) -> np.ndarray:
        """Distances (k,) from which a fit of the curve begins, 0 the first [m]."""
        return np.zeros(1)

    def end_point(self, end: int) -> np.ndarray:
        """Point (3,) at the start (0) or the end (-1)."""
        return np.asarray(self.at(np.array([0.0 if end == 0 else self.length]))[0])


@dataclass(frozen=True, eq=False)
class Line(ToolCurve):
    """Straight line between two points (3,) [m]."""

    start: np.ndarray
    end: np.ndarray

    @property
    def length(self) -> float:  # type: ignore[override]
        """[m]."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def _direction(self) -> np.ndarray:
        return np.asarray((self.end - self.start) / self.length)

    def at(self, along: np.ndarray) -> np.ndarray:
        """Points on the line."""
        return np.asarray(self.start + along[:, None] * self._direction)

    def end_derivatives(self, end: int) -> tuple[np.ndarray, np.ndarray]:
        """Direction, and no curvature."""
        return self._direction, np.zeros(3)

    def cut(self, before: float, after: float) -> Line:
        """Shorter line."""
        along = self._direction
        return Line(self.start + before * along, self.end - after * along)


@dataclass(frozen=True, eq=False)
class Arc(ToolCurve):
    """Arc of a circle."""

    middle: np.ndarray  # (3,) [m]
    # (3,) [m] radius vectors at the angle 0 and a quarter turn later.
    first: np.ndarray
    across: np.ndarray
    # [rad].
    begin: float
    angle: float

    @classmethod
    def through(cls, start: np.ndarray, via: np.ndarray, end: np.ndarray, where: str) -> Arc:
        """Arc from start to end through a point; `where` names it in messages."""
        a, b = via - start, end - start
        normal = np.cross(a, b)
        if np.linalg.norm(normal) < 1e-6 * np.linalg.norm(a) * np.linalg.norm(b) + 1e-12:
            raise ProblemError(
                f"{where}: start, `through` and end lie on a line. Give a point beside it."
            )
        square = normal @ normal
        middle = start + (np.cross(normal, a) * (b @ b) - np.cross(normal, b) * (a @ a)) / (
            2 * square
        )
        first = start - middle
        across = np.cross(normal / np.sqrt(square), first)
        angle = np.arctan2((end - middle) @ across, (end - middle) @ first)
        return cls(middle, first, across, 0.0, float(angle + 2.0 * np.pi * (angle <= 0.0)))

    @property
    def length(self) -> float:  # type: ignore[override]
        """[m]."""
        return float(self.angle * np.linalg.norm(self.first))

    def at(self, along: np.ndarray) -> np.ndarray:
        """Points on the arc."""
        turned = self.begin + along[:, None] / np.linalg.norm(self.first)
        return np.asarray(self.middle + np.cos(turned) * self.first + np.sin(turned) * self.across)

    def end_derivatives(self, end: int) -> tuple[np.ndarray, np.ndarray]:
        """Tangent, and curvature towards the centre."""
        turned, radius = self.begin - end * self.angle, float(np.linalg.norm(self.first))
        outward = (np.cos(turned) * self.first + np.sin(turned) * self.across) / radius
        tangent = (np.cos(turned) * self.across - np.sin(turned) * self.first) / radius
        return tangent, -outward / radius

    def cut(self, before: float, after: float) -> Arc:
        """Shorter arc."""
        radius = float(np.linalg.norm(self.first))
        return Arc(
            self.middle,
            self.first,
            self.across,
            self.begin + before / radius,
            self.angle - (before + after) / radius,
        )


class Curve(ToolCurve):
    """Smooth parametric curve r(u), with a table of its arc length.

    `spline` (u, order) -> (K, 3). `begin` and `end`: range of u. `steps`: of the table.
    """

    def __init__(
        self, spline: Callable[..., np.ndarray], begin: float, end: float, steps: int
    ) -> None:
        self._spline, self._steps = spline, steps
        u = np.linspace(begin, end, steps + 1)
        rate = np.linalg.norm(spline(u, 1), axis=1)
        middle = np.linalg.norm(spline(0.5 * (u[1:] + u[:-1]), 1), axis=1)
        parts = np.diff(u) * (rate[:-1] + 4.0 * middle + rate[1:]) / 6.0
        self._u, self._along = u, np.concatenate([[0.0], np.cumsum(parts)])
        self.length = float(self._along[-1])

    @classmethod
    def through(cls, points: np.ndarray) -> Curve:
        """Spline with continuous curvature through points (m, 3), by chord length."""
        u = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return cls(
            scipy.interpolate.CubicSpline(u, points), 0.0, float(u[-1]), _TABLE_STEPS * (len(u) - 1)
        )

    @property
    def point_distances(self) -> np.ndarray:
        """Distances (m,) of the points that the spline was made through [m]."""
        return self._along[::_TABLE_STEPS]

    def marks(self) -> np.ndarray:
        """Every fourth point of a spline; the start of a blend."""
        # Points of a spline per place where a fit of it begins.
        stride = (
            4 * _TABLE_STEPS if isinstance(self._spline, scipy.interpolate.CubicSpline) else None
        )
        return self._along[:-1:stride] if stride else self._along[:1]

    def parameter(self, along: np.ndarray) -> np.ndarray:
        """U (K,) at distances (K,)."""
        inside = np.clip(along, 0.0, self.length)
        u = np.interp(inside, self._along, self._u)
        k = np.clip(np.searchsorted(self._along, inside, side="right") - 1, 0, self._steps - 1)
        for _ in range(2):
            # From the table's point by Simpson's rule.
            step = u - self._u[k]
            ends = [
                np.linalg.norm(self._spline(self._u[k] + share * step, 1), axis=1)
                for share in (0.0, 0.5, 1.0)
            ]
            covered = step * (ends[0] + 4.0 * ends[1] + ends[2]) / 6.0
            u = u - (self._along[k] + covered - inside) / ends[2]
        return np.asarray(np.clip(u, self._u[0], self._u[-1]))

    def at(self, along: np.ndarray) -> np.ndarray:
        """Points on the curve."""
        return np.asarray(self._spline(self.parameter(along)))

    def end_derivatives(self, end: int) -> tuple[np.ndarray, np.ndarray]:
        """Tangent and curvature of the spline."""
        u = self._u[[end]]
        first, second = self._spline(u, 1)[0], self._spline(u, 2)[0]
        speed = np.linalg.norm(first)
        tangent = first / speed
        return tangent, (second - (second @ tangent) * tangent) / speed**2

    def cut(self, before: float, after: float) -> Curve:
        """Shorter curve."""
        if before <= 0.0 and after <= 0.0:
            return self
        begin, end = self.parameter(np.array([before, self.length - after]))
        share = (end - begin) / (self._u[-1] - self._u[0])
        steps = max(_TABLE_STEPS, int(np.ceil(share * self._steps)))
        return Curve(self._spline, float(begin), float(end), steps)


class _Quintic:
    """Polynomial r(u), u from 0 to 1, by point and two derivatives at both ends."""

    def __init__(self, first: np.ndarray, last: np.ndarray) -> None:
        ends = np.vstack([first, last])
        matrix = np.zeros((6, 6))
        for order in range(3):
            for power in range(order, 6):
                factor = float(np.prod(np.arange(power - order + 1, power + 1)))
                matrix[order, power] = factor if power == order else 0.0
                matrix[3 + order, power] = factor
        self._powers = np.linalg.solve(matrix, ends)

    def __call__(self, u: np.ndarray, order: int = 0) -> np.ndarray:
        powers = self._powers
        for _ in range(order):
            powers = powers[1:] * np.arange(1, len(powers))[:, None]
        return np.vander(u, len(powers), increasing=True) @ powers


def blend_curve(one: ToolCurve, other: ToolCurve, size: float) -> Curve:
    """Blend from the end of one curve to the start of another, with continuous curvature.

    `size` [m] is the distance of both from the corner.
    """
    # Parameter length of a blend over its size: the length of a slight corner.
    length = 2.0 * size
    ends = []
    for curve, end in ((one, -1), (other, 0)):
        tangent, curvature = curve.end_derivatives(end)
        ends.append(np.stack([curve.end_point(end), length * tangent, length**2 * curvature]))
    return Curve(_Quintic(*ends), 0.0, 1.0, 200)
