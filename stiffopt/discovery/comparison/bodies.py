"""Inertial parameters of all bodies, free: the rigid model re-identified about the nominal one.

A body has ten: mass m, first moments m c and inertia about its joint's origin, in the order of the
regressor. Which combinations of them a motion shows (the base parameters) is left to the prior: it
holds those that show nothing where the nominal model has them. Bodies that exist have a positive
semidefinite pseudo-inertia (Wensing, Kim, Slotine 2018); fits keep to them by its Cholesky factor
(Rucker, Wensing 2022).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from stiffopt.discovery.comparison.nominal_robot import RobotModel

PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_A_BODY = len(PARAMETERS)
# Least length [m] and share of the arm's mass that a body's parameters are measured against.
_LENGTH, _SHARE = 0.05, 0.02
# Where (row, column) of the pseudo-inertia each product of inertia stands, Ixy, Ixz, Iyz.
_PRODUCTS = {5: (0, 1), 7: (0, 2), 8: (1, 2)}
_MOMENTS = (4, 6, 9)
_LOWER = np.tril_indices(4)
# Of the unit of a body, what its nominal pseudo-inertia is lifted by where it is on the border.
_LIFT = 1e-6


def names_of_body(body: int) -> list[str]:
    """Names of the ten parameters of a body (from 0): "body 2 mx"."""
    return [f"body {body + 1} {name}" for name in PARAMETERS]


def body_names(robot: RobotModel) -> list[str]:
    """Names of all parameters in the regressor's order."""
    return [name for body in range(robot.n) for name in names_of_body(body)]


def body_units(robot: RobotModel) -> np.ndarray:
    """Typical size of every parameter (n, 10) [kg], [kg m], [kg m^2]."""
    nominal = nominal_bodies(robot)
    mass = np.maximum(nominal[:, 0], _SHARE * nominal[:, 0].sum())
    gyration = np.sqrt(nominal[:, _MOMENTS].sum(axis=1) / (2.0 * mass))
    length = np.maximum(gyration, _LENGTH)
    powers = np.array([0] + [1] * 3 + [2] * 6)
    return np.asarray(mass[:, None] * length[:, None] ** powers)


def nominal_bodies(robot: RobotModel) -> np.ndarray:
    """Nominal inertial parameters (n, 10)."""
    return np.array([robot.arm.tree.bodies[j].inertial_parameters for j in robot.order])


def body_torque(
    robot: RobotModel, regressor: np.ndarray, change: Mapping[str, float]
) -> np.ndarray | None:
    """Torques (K, n) of changed parameters, by their names; None where none is.

    Parameters
    ----------
    robot : RobotModel
    regressor : array (K, n, 10 n)
    change : mapping of str to float
    """
    values = np.array([change.get(name, 0.0) for name in body_names(robot)])
    return np.asarray(regressor @ values) if values.any() else None


def body_columns(robot: RobotModel, regressor: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Torques (K, n) for a unit of every parameter, with its name."""
    for k, name in enumerate(body_names(robot)):
        yield name, regressor[:, :, k]


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """Second moments of the mass about the joint's origin (..., 4, 4), mass last.

    Parameters
    ----------
    parameters : array (..., 10)
    """
    out = np.zeros((*parameters.shape[:-1], 4, 4))
    half = 0.5 * parameters[..., _MOMENTS].sum(axis=-1)
    for axis, k in enumerate(_MOMENTS):
        out[..., axis, axis] = half - parameters[..., k]
    for k, (row, column) in _PRODUCTS.items():
        out[..., row, column] = out[..., column, row] = -parameters[..., k]
    out[..., :3, 3] = out[..., 3, :3] = parameters[..., 1:4]
    out[..., 3, 3] = parameters[..., 0]
    return out


def inertial_parameters(pseudo: np.ndarray) -> np.ndarray:
    """The ten parameters (..., 10) of pseudo-inertias."""
    out = np.empty((*pseudo.shape[:-2], _A_BODY))
    out[..., 0] = pseudo[..., 3, 3]
    out[..., 1:4] = pseudo[..., :3, 3]
    trace = np.trace(pseudo[..., :3, :3], axis1=-2, axis2=-1)
    for axis, k in enumerate(_MOMENTS):
        out[..., k] = trace - pseudo[..., axis, axis]
    for k, (row, column) in _PRODUCTS.items():
        out[..., k] = -pseudo[..., row, column]
    return out


def exist(parameters: np.ndarray, units: np.ndarray) -> bool:
    """Whether bodies (n, 10) can be made of matter, up to rounding in their units."""
    return bool(np.linalg.eigvalsh(_scaled(parameters, units)).min() >= -_LIFT)


def nearest_bodies(
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
    bodies = np.zeros(len(moment), dtype=bool)
    bodies[place] = True
    loose = np.isinf(limits) & ~bodies
    if loose.any():
        # What has no limits follows from all the rest: the rest is sought without it.
        kept = np.flatnonzero(~loose)
        own, cross = gram[np.ix_(loose, loose)], gram[np.ix_(loose, kept)]
        away = np.linalg.solve(own, cross)
        first = int(np.count_nonzero(kept < (place.start or 0)))
        found = np.empty(len(moment))
        found[kept] = nearest_bodies(
            gram[np.ix_(kept, kept)] - cross.T @ away,
            moment[kept] - away.T @ moment[loose],
            slice(first, first + int(bodies.sum())),
            nominal,
            units,
            limits[kept],
        )
        found[loose] = np.linalg.solve(own, moment[loose] - cross @ found[kept])
        return found
    root = np.linalg.cholesky(gram)
    goal = solve_triangular(root, moment, lower=True)
    free = np.linalg.solve(gram, moment)
    others = np.ones(len(moment), dtype=bool)
    others[place] = False
    factors = _factors(nominal + free[place].reshape(-1, _A_BODY), units)
    count = factors.size

    def values(at: np.ndarray) -> np.ndarray:
        out = np.empty(len(moment))
        lower = np.zeros((len(nominal), 4, 4))
        lower[:, *_LOWER] = at[:count].reshape(-1, _A_BODY)
        bodies = _unscaled(lower @ lower.swapaxes(1, 2), units)
        out[place] = (bodies - nominal).ravel()
        out[others] = at[count:]
        return out

    def slopes(at: np.ndarray) -> np.ndarray:
        out = np.zeros((len(moment), len(at)))
        out[np.flatnonzero(others), count + np.arange(int(others.sum()))] = 1.0
        lower = np.zeros((len(nominal), 4, 4))
        lower[:, *_LOWER] = at[:count].reshape(-1, _A_BODY)
        first = place.start or 0
        for k, (row, column) in enumerate(zip(*_LOWER, strict=True)):
            step = np.zeros((4, 4))
            step[row, column] = 1.0
            moved = step @ lower.swapaxes(1, 2)
            change = _unscaled(moved + moved.swapaxes(1, 2), units)
            for body in range(len(nominal)):
                rows = slice(first + _A_BODY * body, first + _A_BODY * (body + 1))
                out[rows, _A_BODY * body + k] = change[body]
        return np.asarray(root.T @ out)

    start = np.concatenate(
        [factors.ravel(), np.clip(free[others], -limits[others], limits[others])]
    )
    bound = np.concatenate([np.full(count, np.inf), limits[others]])
    solved = least_squares(
        lambda at: root.T @ values(at) - goal,
        start,
        slopes,
        bounds=(-bound, bound),
        x_scale="jac",
        max_nfev=200,
    )
    return values(solved.x)


def _factors(bodies: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Lower Cholesky factors (n, 10) of the nearest bodies that exist, in their units."""
    size, vectors = np.linalg.eigh(_scaled(bodies, units))
    lifted = (vectors * np.maximum(size, _LIFT)[:, None, :]) @ vectors.swapaxes(1, 2)
    return np.asarray(np.linalg.cholesky(lifted)[:, *_LOWER])


def _scales(units: np.ndarray) -> np.ndarray:
    """What rows of the pseudo-inertia are measured in (n, 4)."""
    root = np.sqrt(units[:, 0])
    length = units[:, 1] / units[:, 0]
    return np.column_stack([*(root * length,) * 3, root])


def _scaled(bodies: np.ndarray, units: np.ndarray) -> np.ndarray:
    scales = _scales(units)
    return np.asarray(pseudo_inertia(bodies) / (scales[:, :, None] * scales[:, None, :]))


def _unscaled(pseudo: np.ndarray, units: np.ndarray) -> np.ndarray:
    scales = _scales(units)
    return inertial_parameters(pseudo * scales[:, :, None] * scales[:, None, :])
