"""Antiderivative of an exact compliance curve, to quadrature accuracy and cheap to evaluate.

The curve is expanded in Legendre polynomials on panels that are halved until the expansion has
converged, so that kinks need not be known beforehand; integrating the expansions is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import numpy as np
from numpy.polynomial import legendre

_GAUSS_ORDER = 10
_POINTWISE_TOLERANCE = 1e-8
_GAUSS_POINTS, _GAUSS_WEIGHTS = legendre.leggauss(_GAUSS_ORDER)
# Values at the Gauss points -> Legendre coefficients, by discrete orthogonality.
_LEGENDRE_PROJECTION = (
    (np.arange(_GAUSS_ORDER) + 0.5)[:, None]
    * legendre.legvander(_GAUSS_POINTS, _GAUSS_ORDER - 1).T
    * _GAUSS_WEIGHTS
)


@dataclass(frozen=True)
class Antiderivative:
    """Integral from zero of a positive even function, as an odd function of its upper limit."""

    edges: np.ndarray  # (k + 1,) panel borders from 0 to the largest argument
    coefficients: np.ndarray  # (k, order + 1) Legendre series of the integral inside each panel
    slopes: np.ndarray  # (k, order) of the function itself
    # (k,) True where that series holds to 1e-8 at every point: False beside an undeclared jump and
    # where the panel's contribution to the integral is negligible.
    sharp: np.ndarray

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the integral from 0 to `x` (any shape); |x| must not exceed the last edge."""
        x = np.asarray(x, dtype=float)
        value = _evaluate_series(
            self._integral_powers, *self._locate_panel(np.abs(x).ravel(), "left")
        )
        # Zero at 0, even where the function is unbounded there.
        moved = x != 0.0
        out = np.zeros(x.shape)
        np.multiply(np.sign(x), value.reshape(x.shape), out=out, where=moved)
        return out

    def slope(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the function at `x` (any shape), right of a jump, and where it holds to 1e-8."""
        x = np.asarray(x, dtype=float)
        panel, local = self._locate_panel(np.abs(x).ravel(), "right")
        value = _evaluate_series(self._slope_powers, panel, local)
        return value.reshape(x.shape), self.sharp[panel].reshape(x.shape)

    def _locate_panel(
        self, size: np.ndarray, side: Literal["left", "right"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the panel of each argument and its local coordinate, -1 to 1."""
        panel = np.clip(np.searchsorted(self.edges, size, side) - 1, 0, len(self.edges) - 2)
        left, right = self.edges[panel], self.edges[panel + 1]
        return panel, (2.0 * size - left - right) / (right - left)

    @cached_property
    def _integral_powers(self) -> np.ndarray:
        return _monomial_coefficients(self.coefficients)

    @cached_property
    def _slope_powers(self) -> np.ndarray:
        return _monomial_coefficients(self.slopes)


def _monomial_coefficients(series: np.ndarray) -> np.ndarray:
    """Convert Legendre series (k, m), whose first term may be infinite, to power series (m, k).

    Power series are evaluated four times as fast; the loss of accuracy is negligible because the
    higher terms of a converged series are small.
    """
    powers = _legendre_as_monomials(series.shape[1])[1:].T @ series[:, 1:].T
    powers[0] += series[:, 0]
    return np.asarray(powers)


@cache
def _legendre_as_monomials(count: int) -> np.ndarray:
    """Return the first Legendre polynomials as power series (m, k), one a row."""
    columns = [legendre.leg2poly(row) for row in np.eye(count)]
    return np.array([np.pad(column, (0, count - len(column))) for column in columns])


def _evaluate_series(powers: np.ndarray, panel: np.ndarray, local: np.ndarray) -> np.ndarray:
    value = powers[-1].take(panel)
    for row in powers[-2::-1]:
        value *= local
        value += row.take(panel)
    return np.asarray(value)


def antiderivative(
    function: Callable[[np.ndarray], np.ndarray],
    upper: float,
    breakpoints: Sequence[float] = (),
    *,
    relative_tolerance: float = 1e-10,
) -> Antiderivative:
    """Return the antiderivative of `function` on [0, `upper`].

    `function`: (k,) -> (k,), positive; vectorised. `upper`: largest argument, above 0.
    `breakpoints`: known jumps and kinks of the function. `relative_tolerance`: of the integral over
    each panel, hence of the whole. Where the function is infinite or NaN the integral is infinite
    from there on.
    """
    # Contact compliance changes over decades of torque: panels grow geometrically from zero.
    graded = upper * 2.0 ** np.arange(-30.0, 1.0)
    inner = [b for b in breakpoints if 0.0 < b < upper]
    edges = np.unique(np.concatenate(([0.0], graded, inner)))
    pending = np.column_stack((edges[:-1], edges[1:]))
    done: list[tuple[float, float, np.ndarray, bool]] = []
    smallest, settled_sum = upper * 2.0**-45, 0.0
    while len(pending):
        half = (pending[:, 1] - pending[:, 0]) / 2.0
        middle = (pending[:, 1] + pending[:, 0]) / 2.0
        points = middle[:, None] + half[:, None] * _GAUSS_POINTS
        values = np.asarray(function(points.ravel()), dtype=float).reshape(points.shape)
        finite = np.isfinite(values)
        # A panel with some infinite values is halved until their border is located.
        infinite = np.asarray(~finite.any(axis=1) | (~finite.all(axis=1) & (half < smallest)))
        series = np.where(finite, values, 0.0) @ _LEGENDRE_PROJECTION.T
        tail = np.abs(series[:, -2:]).sum(axis=1)
        whole = settled_sum + 2.0 * float(np.sum(series[:, 0] * half))
        # A contribution below the tolerance may be rounding noise, which never converges.
        small = tail * half <= 1e-3 * relative_tolerance * whole
        converged = small | (tail <= relative_tolerance * np.abs(series[:, 0]))
        settled = np.asarray(infinite | (finite.all(axis=1) & converged) | (half < smallest))
        sharp = finite.all(axis=1) & (tail <= _POINTWISE_TOLERANCE * np.abs(series[:, 0]))
        series[infinite, 0] = np.inf
        for k in np.flatnonzero(settled).tolist():
            done.append((pending[k, 0], half[k], series[k], bool(sharp[k])))
        settled_sum += 2.0 * float(np.sum((series[:, 0] * half)[settled & ~infinite]))
        # Beyond an infinite panel the integral is infinite anyway.
        border = float(np.min(pending[infinite, 0], initial=np.inf))
        open_ = np.logical_not(settled) & (pending[:, 0] < border)
        left = np.column_stack((pending[open_, 0], middle[open_]))
        right = np.column_stack((middle[open_], pending[open_, 1]))
        pending = np.vstack((left, right))
    done.sort(key=lambda panel: panel[0])
    series = np.array([slopes * half_width for _, half_width, slopes, _ in done])
    ends = np.cumsum(2.0 * series[:, 0])
    known = np.isfinite(ends)
    integrals = np.zeros((len(done), _GAUSS_ORDER + 1))
    integrals[known] = legendre.legint(series[known], lbnd=-1, axis=1)
    integrals[:, 0] += np.where(known, np.concatenate([[0.0], ends[:-1]]), np.inf)
    return Antiderivative(
        edges=np.array([panel[0] for panel in done] + [upper]),
        coefficients=integrals,
        slopes=np.array([panel[2] for panel in done]),
        sharp=np.array([panel[3] for panel in done]),
    )
