"""Inertial parameters of all bodies, and the likeliest physically consistent ones.

A body has ten: mass m, first moments m c and inertia about the origin of its joint, in the order of
the regressor. The prior keeps combinations that a motion does not show (all but the base
parameters) at the nominal model. Physically consistent bodies have a positive semidefinite
pseudo-inertia (Wensing, Kim, Slotine 2018); the likeliest ones are a convex programme over it,
solved by Newton steps along the central path of its logarithmic barrier, each in local coordinates
(Nesterov, Nemirovskii 1994), in which bodies near the border are as well scaled as any.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.signals import PARAMETERS_PER_BODY

INERTIAL_PARAMETER_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
# Smallest radius of gyration [m] and share of the arm's mass in the units of a body's parameters.
_MIN_GYRATION_RADIUS, _MIN_MASS_SHARE = 0.05, 0.02
# Entries (row, column) of the pseudo-inertia for the products of inertia Ixy, Ixz, Iyz.
_PRODUCT_ENTRIES = {5: (0, 1), 7: (0, 2), 8: (1, 2)}
_MOMENT_ENTRIES = (4, 6, 9)
# Powers of a length in the units of the ten inertial parameters of a body.
LENGTH_POWERS = np.array([0] + [1] * 3 + [2] * 6)
# Smallest scaled eigenvalue of a consistent pseudo-inertia, for rounding errors.
_CONSISTENCY_TOLERANCE = 1e-6
# Smallest eigenvalue over the largest one in the initial guess of a fit.
_MIN_EIGENVALUE_RATIO = 1e-3


def body_parameter_names(body: int) -> list[ValueName]:
    """Return the names of the ten parameters of a body (from 0): "body 2 mx"."""
    return [ValueName("body", body, name) for name in INERTIAL_PARAMETER_NAMES]


def all_body_parameter_names(robot: RobotModel) -> list[ValueName]:
    """Return the names of all parameters in the order of the regressor."""
    return [name for body in range(robot.n) for name in body_parameter_names(body)]


def body_units(robot: RobotModel) -> np.ndarray:
    """Return the typical size of every parameter (n, 10) [kg], [kg m], [kg m^2]."""
    nominal = nominal_bodies(robot)
    mass = np.maximum(nominal[:, 0], _MIN_MASS_SHARE * nominal[:, 0].sum())
    gyration = np.sqrt(nominal[:, _MOMENT_ENTRIES].sum(axis=1) / (2.0 * mass))
    length = np.maximum(gyration, _MIN_GYRATION_RADIUS)
    return np.asarray(mass[:, None] * length[:, None] ** LENGTH_POWERS)


def nominal_bodies(robot: RobotModel) -> np.ndarray:
    """Return the nominal inertial parameters (n, 10)."""
    return np.array([robot.arm.tree.bodies[j].inertial_parameters for j in robot.order])


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """Return second moments of mass about the joint's origin (..., 4, 4), mass last."""
    out = np.zeros((*parameters.shape[:-1], 4, 4))
    half = 0.5 * parameters[..., _MOMENT_ENTRIES].sum(axis=-1)
    for axis, k in enumerate(_MOMENT_ENTRIES):
        out[..., axis, axis] = half - parameters[..., k]
    for k, (row, column) in _PRODUCT_ENTRIES.items():
        out[..., row, column] = out[..., column, row] = -parameters[..., k]
    out[..., :3, 3] = out[..., 3, :3] = parameters[..., 1:4]
    out[..., 3, 3] = parameters[..., 0]
    return out


def inertial_parameters(pseudo: np.ndarray) -> np.ndarray:
    """Return the ten parameters (..., 10) of pseudo-inertias."""
    out = np.empty((*pseudo.shape[:-2], PARAMETERS_PER_BODY))
    out[..., 0] = pseudo[..., 3, 3]
    out[..., 1:4] = pseudo[..., :3, 3]
    trace = np.trace(pseudo[..., :3, :3], axis1=-2, axis2=-1)
    for axis, k in enumerate(_MOMENT_ENTRIES):
        out[..., k] = trace - pseudo[..., axis, axis]
    for k, (row, column) in _PRODUCT_ENTRIES.items():
        out[..., k] = -pseudo[..., row, column]
    return out


def is_consistent(parameters: np.ndarray, units: np.ndarray) -> bool:
    """Return True where bodies (n, 10) are physically consistent up to rounding."""
    return bool(
        np.linalg.eigvalsh(scaled_pseudo_inertia(parameters, units)).min()
        >= -_CONSISTENCY_TOLERANCE
    )


def make_consistent(bodies: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Return bodies (n, 10) with eigenvalues lifted to strict physical consistency."""
    size, vectors = np.linalg.eigh(scaled_pseudo_inertia(bodies, units))
    size = np.maximum(size, _MIN_EIGENVALUE_RATIO * np.maximum(size[:, -1:], _MIN_EIGENVALUE_RATIO))
    lifted = (vectors * size[:, None, :]) @ vectors.swapaxes(1, 2)
    scales = pseudo_inertia_scales(units)
    return inertial_parameters(lifted * scales[:, :, None] * scales[:, None, :])


def pseudo_inertia_scales(units: np.ndarray) -> np.ndarray:
    """Return the scales (n, 4) of the rows of the pseudo-inertias."""
    root = np.sqrt(units[:, 0])
    length = units[:, 1] / units[:, 0]
    return np.column_stack([*(root * length,) * 3, root])


def scaled_pseudo_inertia(bodies: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Return pseudo-inertias (n, 4, 4) of bodies (n, 10) over their scales."""
    scales = pseudo_inertia_scales(units)
    return np.asarray(pseudo_inertia(bodies) / (scales[:, :, None] * scales[:, None, :]))


# Largest duality gap at the end, of a log density.
_MAX_DUALITY_GAP = 1e-6
# Factor on the barrier's weight once a step is near the central path.
_BARRIER_DECREASE = 0.1
# Longest step over the distance to the border.
_MAX_STEP_TO_BORDER = 0.95
_MAX_NEWTON_STEPS = 400
# Orthonormal basis of symmetric matrices (10, 4, 4), and their traces.
_LOWER_ROWS, _LOWER_COLUMNS = np.tril_indices(4)
_SYMMETRIC_BASIS = np.zeros((PARAMETERS_PER_BODY, 4, 4))
_SYMMETRIC_BASIS[np.arange(PARAMETERS_PER_BODY), _LOWER_ROWS, _LOWER_COLUMNS] = np.where(
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
    """Minimise x' gram x / 2 - moment' x over consistent bodies, other values within limits.

    `gram` (p, p): positive definite. `moment` (p,). `place`: slice of the bodies' parameter changes
    among the values, body after body. `nominal`, `units` (n, 10). `limits` (p,): largest magnitude
    of the other values.
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
    # The factors are carried along, not computed anew from the values: at the border of consistency
    # the pseudo-inertia of the rounded values has eigenvalues below zero.
    lower = np.linalg.cholesky(
        scaled_pseudo_inertia(nominal + x[place].reshape(nominal.shape), units)
    )
    for _ in range(_MAX_NEWTON_STEPS):
        moved = lower[:, None] @ _SYMMETRIC_BASIS @ lower.swapaxes(1, 2)[:, None]
        own = inertial_parameters(moved * outer[:, None])
        above, below = 1.0 / (box - x[boxed]), 1.0 / (box + x[boxed])
        size[boxed] = 1.0 / np.hypot(above, below)
        slope = _to_local_coordinates(own, size, place, (gram @ x - moment)[:, None])[:, 0]
        slope[place] -= weight * np.tile(_BASIS_TRACES, len(nominal))
        slope[boxed] += weight * (above - below) * size[boxed]
        half = _to_local_coordinates(own, size, place, gram)
        curved = _to_local_coordinates(own, size, place, np.ascontiguousarray(half.T))
        curved[place, place] += weight * np.eye(own.shape[0] * PARAMETERS_PER_BODY)
        curved[boxed, boxed] += weight
        local = _solve_scaled(curved, -slope)
        step = size * local
        step[place] = np.einsum("bji,bj->bi", own, local[place].reshape(nominal.shape)).ravel()
        change = np.tensordot(local[place].reshape(nominal.shape), _SYMMETRIC_BASIS, 1)
        nearing = np.append(step[boxed] * above, -step[boxed] * below)
        border = max(float(np.max(nearing, initial=0.0)), -float(np.linalg.eigvalsh(change).min()))
        length = min(1.0, _MAX_STEP_TO_BORDER / max(border, 1e-300))
        x = x + length * step
        lower = lower @ np.linalg.cholesky(np.eye(4) + length * change)
        if -slope @ local < weight:
            if weight * hinders < _MAX_DUALITY_GAP:
                break
            weight *= _BARRIER_DECREASE
    return x


def _to_local_coordinates(
    own: np.ndarray, size: np.ndarray, place: slice, rows: np.ndarray
) -> np.ndarray:
    """Return derivatives (p, c) by local coordinates from those by the values.

    `own` (n, 10, 10): values of each body per unit of its local coordinates, by rows. `size` (p,):
    scale of the other values. `place`: slice of the bodies' values. `rows` (p, c).
    """
    out = size[:, None] * rows
    bodies = rows[place].reshape(len(own), PARAMETERS_PER_BODY, -1)
    out[place] = (own @ bodies).reshape(-1, rows.shape[1])
    return np.asarray(out)


def _solve_scaled(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve with a positive definite matrix, scaled to unit diagonal."""
    unit = 1.0 / np.sqrt(np.diag(matrix))
    _, found, failed = dposv(matrix * (unit[:, None] * unit), unit * right)
    if failed:
        raise np.linalg.LinAlgError("matrix is not positive definite")
    return np.asarray(unit * found)
