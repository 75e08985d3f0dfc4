"""Figures of a path after ISO 9283: accuracy, corners, settling, from simulated places of the tool.

Source: ISO 9283:1998, clauses 8 (path accuracy) and 8.5 (cornering deviations); one run instead of
ten, so that accuracy is its largest distance from the command path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

# Length behind a corner in which its overshoot is taken [m].
_OVERSHOOT_LENGTH = 0.05


@dataclass(frozen=True, kw_only=True)
class PathFigures:
    """Figures of one simulated run along a path."""

    accuracy: float  # largest distance of the tool from the command path [m]
    rounding: tuple[float, ...]  # least distance of the tool from each programmed corner [m]
    # Largest distance from the command path within 50 mm behind each corner [m].
    overshoot: tuple[float, ...]
    # Time after arrival until the tool stays within the settling band [s]; None if it does not.
    settling_time: float | None


def path_figures(
    command: np.ndarray, actual: np.ndarray, corners: np.ndarray, settling_time: float | None
) -> PathFigures:
    """Return the figures of actual places (K, 3) against simultaneous command places (K, 3) [m].

    `corners` (k, 3) [m] are those that were programmed.
    """
    away = distances_to_path(actual, command)
    covered = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(command, axis=0), axis=1))])
    rounding, overshoot = [], []
    passed = 0
    for corner in corners:
        passed += int(np.argmin(np.linalg.norm(command[passed:] - corner, axis=1)))
        behind = (covered >= covered[passed]) & (covered <= covered[passed] + _OVERSHOOT_LENGTH)
        near = np.abs(covered - covered[passed]) <= _OVERSHOOT_LENGTH
        rounding.append(float(np.linalg.norm(actual[near] - corner, axis=1).min()))
        overshoot.append(float(away[behind].max()))
    return PathFigures(
        accuracy=float(away.max()),
        rounding=tuple(rounding),
        overshoot=tuple(overshoot),
        settling_time=settling_time,
    )


def distances_to_path(points: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the distance (K,) [m] of points (K, 3) from the polygon through places (m, 3)."""
    _, near = scipy.spatial.cKDTree(places).query(points)
    found = np.full(len(points), np.inf)
    for shift in (-1, 0):
        k = np.clip(near + shift, 0, len(places) - 2)
        step = places[k + 1] - places[k]
        square = np.maximum(np.sum(step**2, axis=1), 1e-30)
        along = np.clip(np.sum((points - places[k]) * step, axis=1) / square, 0.0, 1.0)
        off = points - places[k] - along[:, None] * step
        found = np.minimum(found, np.linalg.norm(off, axis=1))
    return found
