"""Checks that every connection of a drivetrain has to pass.

Each check returns the worst number it found and raises `CheckFailed` with it when that is too
large. Formulas are taken as plain functions of NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

import numpy as np

from stiffopt.errors import StiffoptError
from stiffopt.exact.connection import breakpoints, tangent_compliance

Formula = Callable[[np.ndarray], np.ndarray]


class CheckFailed(StiffoptError, AssertionError):
    """A property that must hold does not.

    Parameters
    ----------
    name : str
        The property.
    where : float
        The point where it is violated most.
    """

    def __init__(self, name: str, where: float, found: float, allowed: float) -> None:
        self.name, self.where, self.found, self.allowed = name, where, found, allowed
        super().__init__(f"{name}: {found:.3g} at {where:.6g}; allowed is {allowed:.3g}.")


class Smoothed(Protocol):
    """Methods of a connection that `check_smoothed_against_exact` calls.

    A connection defined by a user also has `exact_tangent_compliance(torque, preload=...)`, its
    compliance without smoothing [rad/(N m)], and, where that jumps, `breakpoints()` [N m].
    """

    @property
    def torque_max(self) -> float:
        """Largest torque [N m]."""

    def windup(self, torque: np.ndarray) -> np.ndarray:
        """Smooth wind-up [rad]."""


def check_derivative(
    formula: Formula,
    derivative: Formula,
    points: Iterable[float],
    *,
    scale: float,
    rtol: float = 1e-6,
) -> float:
    """Compare a derivative with central differences (fourth order) of its formula.

    Parameters
    ----------
    formula, derivative : callable
        Elementwise functions of an array.
    scale : float
        Smallest distance over which the formula changes its shape, such as the smoothing width;
        the step is 1e-3 of it, or of the point where that is larger.
    rtol : float
        Allowed error over the derivative (its own size at the point, at least 1e-6 of the largest).
    """
    x = np.array(list(points), dtype=float)
    step = 1e-3 * np.maximum(np.abs(x), scale)
    near = _evaluate_formula(formula, x + step) - _evaluate_formula(formula, x - step)
    far = _evaluate_formula(formula, x + 2 * step) - _evaluate_formula(formula, x - 2 * step)
    difference = (8 * near - far) / (12 * step)
    given = _evaluate_formula(derivative, x)
    size = np.maximum(np.abs(difference), 1e-6 * np.max(np.abs(difference)))
    size = np.where(size > 0.0, size, 1.0)
    return _check_worst_error(
        "derivative against differences", x, np.abs(given - difference) / size, rtol
    )


def check_odd(formula: Formula, points: Iterable[float], *, rtol: float = 1e-12) -> float:
    """Check f(-x) = -f(x), to `rtol` of |f(x)|, and f(0) = 0."""
    x = np.array(list(points), dtype=float)
    forward, back = _evaluate_formula(formula, x), _evaluate_formula(formula, -x)
    origin = float(_evaluate_formula(formula, np.zeros(1))[0])
    if origin != 0.0:
        raise CheckFailed("odd function: value at zero", 0.0, abs(origin), 0.0)
    size = np.where(forward != 0.0, np.abs(forward), 1.0)
    return _check_worst_error(
        "odd function: relative mismatch", x, np.abs(forward + back) / size, rtol
    )


def check_monotone(formula: Formula, points: Iterable[float]) -> float:
    """Check that f grows strictly from point to point; return the least rise."""
    x = np.unique(np.array(list(points), dtype=float))
    rise = np.diff(_evaluate_formula(formula, x))
    worst = int(np.argmin(np.where(np.isfinite(rise), rise, -np.inf)))
    if not rise[worst] > 0.0:
        raise CheckFailed("monotone function: rise", float(x[worst]), float(rise[worst]), 0.0)
    return float(rise[worst])


def check_smoothed_against_exact(
    connection: Smoothed,
    tolerance: float,
    *,
    from_torque: float = 0.0,
    points: int = 25,
) -> float:
    """Compare the smooth wind-up with quadrature of the exact compliance.

    Parameters
    ----------
    tolerance : float
        Allowed |difference| over the exact wind-up.
    from_torque : float
        Start of the integral [N m]. Where the exact compliance is infinite at zero torque (contact
        without prepressure) a start above zero compares the wind-up gained from there on.
    points : int
        Number of torques compared, up to torque_max.
    """
    torque_max = connection.torque_max
    torques = np.geomspace(max(2.0 * from_torque, 1e-2 * torque_max), torque_max, points)
    exact = _exact_windup(connection, from_torque, torques)
    start = float(_evaluate_formula(connection.windup, np.array([from_torque]))[0])
    smooth = _evaluate_formula(connection.windup, torques) - start
    error = np.abs(smooth / exact - 1)
    return _check_worst_error("smoothed wind-up against the exact one", torques, error, tolerance)


def _exact_windup(connection: Smoothed, start: float, torques: np.ndarray) -> np.ndarray:
    # Panels shrink towards zero torque, where contact compliance changes most; jumps lie on
    # panel ends.
    lowest = start if start > 0.0 else 1e-8 * float(torques[-1])
    grid = np.geomspace(lowest, torques[-1], 60)
    jumps = [t for t in breakpoints(connection) if lowest < t < torques[-1]]
    edges = np.unique(np.concatenate([[start, lowest], grid, torques, jumps]))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    samples = middle[:, None] + half[:, None] * nodes
    compliance = tangent_compliance(connection, samples.ravel()).reshape(samples.shape)
    total = np.concatenate([[0.0], np.cumsum(half * (compliance @ weights))])
    return np.asarray(np.interp(torques, edges, total))


def _evaluate_formula(formula: Formula, x: np.ndarray) -> np.ndarray:
    return np.asarray(np.broadcast_to(np.asarray(formula(x), dtype=float), x.shape))


def _check_worst_error(name: str, x: np.ndarray, error: np.ndarray, allowed: float) -> float:
    # NaN counts as the worst value.
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    if not error[worst] <= allowed:
        raise CheckFailed(name, float(x[worst]), float(error[worst]), allowed)
    return float(error[worst])
