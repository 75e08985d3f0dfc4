"""Splines of signals, and what a fit of them predicts of samples left out."""

import numpy as np
from scipy.interpolate import BSpline

_SPLINE_DEGREE = 3


def inner_knots(values: np.ndarray, count: int) -> np.ndarray:
    """Return knots at quantiles of a signal."""
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, count)))


def splines_at(inner: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return cubic B-splines (K, k) at values of a signal; constant beyond the knots."""
    if len(inner) < 2 or not inner[-1] > inner[0]:
        return np.ones((len(values), 1))
    knots = np.concatenate([[inner[0]] * _SPLINE_DEGREE, inner, [inner[-1]] * _SPLINE_DEGREE])
    inside = np.clip(values, inner[0], np.nextafter(inner[-1], inner[0]))
    return np.asarray(BSpline.design_matrix(inside, knots, _SPLINE_DEGREE).toarray())


def predict_blocks(
    columns: np.ndarray, target: np.ndarray, block: np.ndarray, ridge: float
) -> np.ndarray:
    """Predict every block (m,) of a target by a ridge fit of columns to the others."""
    out = np.zeros_like(target)
    gram, moment = columns.T @ columns, columns.T @ target
    gram_ridge = ridge * np.eye(columns.shape[1])
    for b in np.unique(block):
        own = block == b
        part = columns[own]
        rest = np.linalg.solve(gram - part.T @ part + gram_ridge, moment - part.T @ target[own])
        out[own] = part @ rest
    return out
