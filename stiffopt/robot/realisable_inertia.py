"""Inertias that a rigid body can have: positive moments, none above the sum of the others."""

from __future__ import annotations

import numpy as np

# Least moments of inertia [kg m^2], and as a share of the largest, for rounding; MuJoCo refuses
# moments below 1e-15 kg m^2.
_MIN_MOMENT, _MIN_MOMENT_SHARE = 1e-9, 1e-6


def realisable_inertia(inertia: np.ndarray) -> np.ndarray:
    """Raise an inertia (3, 3) to that of a rigid body with the same largest moment."""
    moments, axes = np.linalg.eigh(inertia)
    raised = realisable_moments(moments)
    return inertia if raised is moments else axes @ np.diag(raised) @ axes.T


def realisable_moments(moments: np.ndarray) -> np.ndarray:
    """Raise ascending principal moments (3,) until the triangle inequality holds."""
    least = max(_MIN_MOMENT, _MIN_MOMENT_SHARE * moments[2])
    if moments[0] >= least and moments[0] + moments[1] >= moments[2]:
        return moments
    raised: np.ndarray = np.maximum(moments, least)
    lacking = float((1.0 + _MIN_MOMENT_SHARE) * raised[2] - raised[0] - raised[1])
    raised[:2] += 0.5 * max(lacking, 0.0)
    return raised
