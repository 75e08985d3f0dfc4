"""Linear programmes whose rows couple few neighbouring unknowns, by an interior-point method.

Maximise w x subject to A x <= b, where a row of A has three consecutive entries. The normal matrix
then has two diagonals on either side: a step costs a time proportional to the number of unknowns.

Source: Mehrotra (1992), "On the implementation of a primal-dual interior point method", SIAM
Journal on Optimization 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

# Entries of a row.
WIDTH = 3
_MAX_STEPS = 100
# Relative duality gap and residuals at which the iteration ends.
_GAP_TOLERANCE = 1e-7
# Of the gradient, which rounding spoils first; every step is feasible.
_DUAL_TOLERANCE = 1e-3
# Share of the way to the boundary of the positive orthant that a step goes.
_STEP_SHARE = 0.995
# Added to the diagonal of the normal matrix, relative to it, where rounding spoils its factors.
_DIAGONAL_REGULARISATION = 1e-12


@dataclass(frozen=True, eq=False)
class BandedRows:
    """Rows A x <= b, R at each of K places; those of place k have entries at k to k + 2."""

    entries: np.ndarray  # (3, R, K) coefficients
    bound: np.ndarray  # (R, K) right-hand sides; infinite ones are no rows

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return int(self.bound.shape[1]) + WIDTH - 1

    def times(self, x: np.ndarray) -> np.ndarray:
        """A x (R, K)."""
        count = self.bound.shape[1]
        found = self.entries[0] * x[:count]
        for k in range(1, WIDTH):
            found += self.entries[k] * x[k : k + count]
        return np.asarray(found)

    def transposed_times(self, weights: np.ndarray) -> np.ndarray:
        """A^T weights (unknowns,), of weights (R, K)."""
        count = self.bound.shape[1]
        found = np.zeros(self.unknowns)
        for k in range(WIDTH):
            found[k : k + count] += np.einsum("rk,rk->k", self.entries[k], weights)
        return found

    def normal_matrix(self, weights: np.ndarray) -> np.ndarray:
        """A^T diag(weights) A in the upper form of `solveh_banded`, (3, unknowns)."""
        count = self.bound.shape[1]
        band = np.zeros((WIDTH, self.unknowns))
        for low in range(WIDTH):
            weighted = weights * self.entries[low]
            for high in range(low, WIDTH):
                own = np.einsum("rk,rk->k", weighted, self.entries[high])
                band[WIDTH - 1 - (high - low), high : high + count] += own
        return band


def maximise(rows: BandedRows, weights: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the unknowns (unknowns,) that maximise weights . x subject to the rows.

    `rows`: they bound the maximum. `weights` (unknowns,). `start` (unknowns,): need not satisfy the
    rows.
    """
    there = np.isfinite(rows.bound)
    bound = np.where(there, rows.bound, 1.0)
    rows = BandedRows(rows.entries * there, bound)
    x = start.copy()
    slack = np.maximum(bound - rows.times(x), 1e-2)
    price = np.full_like(slack, weights.sum() / slack.size) / slack
    count, scale = slack.size, max(1.0, float(np.abs(bound).max()))
    primal = bound - rows.times(x) - slack
    for _ in range(_MAX_STEPS):
        dual = weights - rows.transposed_times(price)
        gap = float(np.vdot(slack, price)) / count
        value = abs(float(weights @ x)) + 1e-12
        if (
            gap * count <= _GAP_TOLERANCE * value
            and np.abs(primal).max() <= _GAP_TOLERANCE * scale
            and np.abs(dual).max() <= _DUAL_TOLERANCE * weights.max()
        ):
            break
        ratio = price / slack
        band = rows.normal_matrix(ratio)
        band[-1] *= 1.0 + _DIAGONAL_REGULARISATION
        aimed = np.zeros_like(slack)
        for corrected in (False, True):
            # Complementarity: slack dprice + price dslack = aimed - slack price.
            short = aimed / slack - price
            right = dual - rows.transposed_times(short - ratio * primal)
            try:
                step = scipy.linalg.solveh_banded(band, right, check_finite=False)
            except scipy.linalg.LinAlgError:
                return x
            moved = primal - rows.times(step)
            dearer = short - ratio * moved
            ahead = _longest_step(slack, moved), _longest_step(price, dearer)
            if not corrected:
                after = np.vdot(slack + ahead[0] * moved, price + ahead[1] * dearer) / count
                centre = (float(after) / gap) ** 3 * gap
                aimed = centre - moved * dearer
        forward, upward = (min(1.0, _STEP_SHARE * each) for each in ahead)
        x = x + forward * step
        slack = slack + forward * moved
        primal = (1.0 - forward) * primal
        price = price + upward * dearer
    return x


def _longest_step(value: np.ndarray, change: np.ndarray) -> float:
    """Return the step at which a value reaches zero, at most 1/_STEP_SHARE."""
    fastest = float((change / value).min())
    return min(1.0 / _STEP_SHARE, -1.0 / fastest) if fastest < 0.0 else 1.0 / _STEP_SHARE
