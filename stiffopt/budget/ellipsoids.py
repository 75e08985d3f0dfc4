"""Ellipsoids and bounds of normally distributed errors in space."""

from __future__ import annotations

import numpy as np
import scipy

# Confidence of every bound.
CONFIDENCE = 0.95


def semi_axes(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return semi-axes of the ellipsoids that hold 95 % of the errors about their mean.

    `covariance` (K, 3, 3). `lengths` (K, 3): the longest first. `directions` (K, 3, 3): as columns.
    """
    squares, axes = np.linalg.eigh(covariance)
    lengths = np.sqrt(float(_chi_squared_quantile(3.0)) * np.maximum(squares, 0.0))
    return lengths[:, ::-1], axes[:, :, ::-1]


def magnitude_bound(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the 95 % quantile (K,) of the length of errors of this mean and covariance.

    `mean` (K, 3). `covariance` (K, 3, 3). The squared length is a quadratic form of normal
    variables. A shifted chi-squared variable takes its first three cumulants (Pearson 1959, Imhof
    1961); the 95 % quantile of the length then has an error below 1 %.
    """
    squares, axes = np.linalg.eigh(covariance)
    squares = np.maximum(squares, 0.0)
    along = np.square(np.einsum("kij,ki->kj", axes, mean))
    first = np.sum(squares + along, axis=1)
    second = 2.0 * np.sum(squares**2 + 2.0 * squares * along, axis=1)
    third = 8.0 * np.sum(squares**3 + 3.0 * squares**2 * along, axis=1)
    # Without spread the length is that of the mean.
    spread = second > 0.0
    safe_second, safe_third = np.where(spread, second, 1.0), np.where(spread, third, 1.0)
    freedom = 8.0 * safe_second**3 / safe_third**2
    quantile = (_chi_squared_quantile(freedom) - freedom) / np.sqrt(2.0 * freedom)
    square = first + np.where(spread, np.sqrt(safe_second) * quantile, 0.0)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _chi_squared_quantile(freedom: float | np.ndarray) -> np.ndarray:
    # Loading scipy.stats takes longer than many a solve.
    return np.asarray(2.0 * scipy.special.gammaincinv(0.5 * freedom, CONFIDENCE))
