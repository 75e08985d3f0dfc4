"""The likeliest bodies that can exist: a convex programme over their pseudo-inertias.

Newton steps along the central path of its logarithmic barrier, each in coordinates of the point
that it begins at (Nesterov, Nemirovskii 1994): there bodies near the border of what can exist are
as well scaled as any.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from stiffopt.discovery.comparison.bodies import (
    A_BODY,
    inertial_parameters,
    make_consistent,
    pseudo_inertia_scales,
    scaled_pseudo_inertia,
)

# Of the objective, a log density: what is left to gain at the end.
_MAX_DUALITY_GAP = 1e-6
# By which the barrier's weight falls where a step has come near enough to the path.
_BARRIER_DECREASE = 0.1
# Of the way to the border that a step goes at most.
_MAX_STEP_TO_BORDER = 0.95
_MAX_NEWTON_STEPS = 400
# Symmetric matrices (10, 4, 4) of unit size, and the trace of each.
_LOWER_ROWS, _LOWER_COLUMNS = np.tril_indices(4)
_SYMMETRIC_BASIS = np.zeros((A_BODY, 4, 4))
_SYMMETRIC_BASIS[np.arange(A_BODY), _LOWER_ROWS, _LOWER_COLUMNS] = np.where(
    _LOWER_ROWS == _LOWER_COLUMNS, 1.0, np.sqrt(0.5)
)
_SYMMETRIC_BASIS = np.maximum(_SYMMETRIC_BASIS, _SYMMETRIC_BASIS.swapaxes(1, 2))
_BASIS_TRACES = np.trace(_SYMMETRIC_BASIS, axis1=1, axis2=2)


def likeliest_consistent_bodies(
    gram: np.ndarray,
    moment: np.ndarray,
    place: slice,
    nominal: np.ndarray,
    units: np.ndarray,
    limits: np.ndarray,
) -> np.ndarray:
    """Least of x' gram x / 2 - moment' x over values whose bodies exist, the others in limits.

    Parameters
    ----------
    gram : array (p, p)
        Positive definite.
    moment : array (p,)
    place : slice
        Of the changes of the bodies' parameters among the values, body after body.
    nominal, units : array (n, 10)
    limits : array (p,)
        Largest size of the other values.

    Returns
    -------
    array (p,)
    """
    others = np.ones(len(moment), dtype=bool)
    others[place] = False
    boxed = np.flatnonzero(others & np.isfinite(limits))
    box = limits[boxed]
    outer = pseudo_inertia_scales(units)[:, :, None] * pseudo_inertia_scales(units)[:, None, :]
    size = 1.0 / np.sqrt(np.diag(gram))
    x = _solve_scaled(gram, moment)
    least = 0.5 * x @ gram @ x - moment @ x
    x[place] = (make_consistent(nominal + x[place].reshape(nominal.shape), units) - nominal).ravel()
    x[boxed] = np.clip(x[boxed], -0.99 * box, 0.99 * box)
    hinders = 4 * len(nominal) + 2 * len(boxed)
    weight = max(0.5 * x @ gram @ x - moment @ x - least, 1.0) / hinders
    for _ in range(_MAX_NEWTON_STEPS):
        lower = np.linalg.cholesky(
            scaled_pseudo_inertia(nominal + x[place].reshape(nominal.shape), units)
        )
        moved = lower[:, None] @ _SYMMETRIC_BASIS @ lower.swapaxes(1, 2)[:, None]
        own = inertial_parameters(moved * outer[:, None])
        above, below = 1.0 / (box - x[boxed]), 1.0 / (box + x[boxed])
        size[boxed] = 1.0 / np.hypot(above, below)
        slope = _to_local_coordinates(own, size, place, (gram @ x - moment)[:, None])[:, 0]
        slope[place] -= weight * np.tile(_BASIS_TRACES, len(nominal))
        slope[boxed] += weight * (above - below) * size[boxed]
        half = _to_local_coordinates(own, size, place, gram)
        curved = _to_local_coordinates(own, size, place, np.ascontiguousarray(half.T))
        curved[place, place] += weight * np.eye(own.shape[0] * A_BODY)
        curved[boxed, boxed] += weight
        local = _solve_scaled(curved, -slope)
        step = size * local
        step[place] = np.einsum("bji,bj->bi", own, local[place].reshape(nominal.shape)).ravel()
        change = np.tensordot(local[place].reshape(nominal.shape), _SYMMETRIC_BASIS, 1)
        nearing = np.append(step[boxed] * above, -step[boxed] * below)
        border = max(float(np.max(nearing, initial=0.0)), -float(np.linalg.eigvalsh(change).min()))
        x = x + min(1.0, _MAX_STEP_TO_BORDER / max(border, 1e-300)) * step
        if -slope @ local < weight:
            if weight * hinders < _MAX_DUALITY_GAP:
                break
            weight *= _BARRIER_DECREASE
    return x


def _to_local_coordinates(
    own: np.ndarray, size: np.ndarray, place: slice, rows: np.ndarray
) -> np.ndarray:
    """Slopes (p, c) by steps in the point's own coordinates, from those by the values.

    Parameters
    ----------
    own : array (n, 10, 10)
        Values of each body for a unit of its own coordinates, by rows.
    size : array (p,)
        Of the other values.
    place : slice
        Of the bodies' values.
    rows : array (p, c)
    """
    out = size[:, None] * rows
    bodies = rows[place].reshape(len(own), A_BODY, -1)
    out[place] = (own @ bodies).reshape(-1, rows.shape[1])
    return np.asarray(out)


def _solve_scaled(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution with a positive definite matrix, in units that make its diagonal one."""
    unit = 1.0 / np.sqrt(np.diag(matrix))
    _, found, failed = dposv(matrix * (unit[:, None] * unit), unit * right)
    if failed:
        raise np.linalg.LinAlgError("matrix is not positive definite")
    return np.asarray(unit * found)
