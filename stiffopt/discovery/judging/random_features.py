"""Smooth functions of a few dozen signals, fitted as a Gaussian process would, in plain NumPy.

Random Fourier features (Rahimi, Recht 2007): cosines with random frequencies, whose ridge fit is
that of a process with a Gaussian kernel; lengths and ridge by stretches left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Cosines, and lengths of the kernel over the spread of the signals that are tried, with ridges.
FEATURES = 200
_LENGTHS = (0.5, 1.0, 2.0, 4.0)
_RIDGES = (1e-3, 1e-2, 1e-1, 1.0)
_SEED = 7


@dataclass(frozen=True, eq=False)
class SmoothFunction:
    """A function of signals.

    Parameters
    ----------
    middle, spread : array (s,)
        Of the signals.
    waves : array (s, f)
    phases, weights : array (f,)
    limit : float
        Largest value that was seen; it never says more.
    taken : float
        Share of the squares that it takes away in stretches left out.
    """

    middle: np.ndarray
    spread: np.ndarray
    waves: np.ndarray
    phases: np.ndarray
    weights: np.ndarray
    limit: float
    taken: float

    def __call__(self, signals: np.ndarray) -> np.ndarray:
        """Values (m,) at signals (m, s)."""
        scaled = (signals - self.middle) / self.spread
        values = np.cos(scaled @ self.waves + self.phases) @ self.weights
        return np.asarray(np.clip(values, -self.limit, self.limit))


def smooth_function(
    signals: np.ndarray, values: np.ndarray, stretch: np.ndarray
) -> SmoothFunction | None:
    """The function that predicts stretches left out best; None where none does.

    Parameters
    ----------
    signals : array (m, s)
    values : array (m,)
    stretch : array (m,) of int
        That each sample is of.
    """
    middle, spread = signals.mean(axis=0), signals.std(axis=0)
    spread = np.where(spread > 1e-12, spread, 1.0)
    scaled = (signals - middle) / spread / np.sqrt(signals.shape[1])
    draw = np.random.default_rng(_SEED)
    directions = draw.standard_normal((signals.shape[1], FEATURES))
    phases = draw.uniform(0.0, 2.0 * np.pi, FEATURES)
    parts = [stretch == k for k in np.unique(stretch)]
    whole = float(values @ values)
    best: tuple[float, float, float] | None = None
    for length in _LENGTHS:
        columns = np.cos(scaled @ (directions / length) + phases)
        grams = [columns[p].T @ columns[p] for p in parts]
        moments = [columns[p].T @ values[p] for p in parts]
        gram, moment = sum(grams), sum(moments)
        for ridge in _RIDGES:
            load = ridge * len(values) * np.eye(FEATURES) / FEATURES
            left = 0.0
            for own, inner, goal in zip(parts, grams, moments, strict=True):
                weights = np.linalg.solve(gram - inner + load, moment - goal)
                left += float(np.sum((values[own] - columns[own] @ weights) ** 2))
            if best is None or left < best[0]:
                best = left, length, ridge
    if best is None or best[0] >= whole:
        return None
    left, length, ridge = best
    waves = directions / length
    columns = np.cos(scaled @ waves + phases)
    load = ridge * len(values) * np.eye(FEATURES) / FEATURES
    return SmoothFunction(
        middle=middle,
        spread=spread,
        waves=waves / np.sqrt(signals.shape[1]),
        phases=phases,
        weights=np.linalg.solve(columns.T @ columns + load, columns.T @ values),
        limit=float(np.abs(values).max()),
        taken=1.0 - left / whole,
    )
