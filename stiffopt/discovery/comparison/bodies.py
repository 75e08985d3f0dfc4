"""Inertial parameters of all bodies, free: the rigid model re-identified about the nominal one.

A body has ten: mass m, first moments m c and inertia about its joint's origin, in the order of the
regressor. Which combinations of them a motion shows (the base parameters) is left to the prior: it
holds those that show nothing where the nominal model has them. Bodies that exist have a positive
semidefinite pseudo-inertia (Wensing, Kim, Slotine 2018), to which fits keep.
"""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel

INERTIAL_PARAMETER_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
A_BODY = len(INERTIAL_PARAMETER_NAMES)
# Least length [m] and share of the arm's mass that a body's parameters are measured against.
_MIN_GYRATION_RADIUS, _MIN_MASS_SHARE = 0.05, 0.02
# Where (row, column) of the pseudo-inertia each product of inertia stands, Ixy, Ixz, Iyz.
_PRODUCT_ENTRIES = {5: (0, 1), 7: (0, 2), 8: (1, 2)}
_MOMENT_ENTRIES = (4, 6, 9)
# Of the unit of a body, by which rounding may make of it what cannot exist.
_CONSISTENCY_TOLERANCE = 1e-6
# Of the largest of a body's second moments, what others have at least where a fit begins.
_MIN_EIGENVALUE_RATIO = 1e-3


def body_parameter_names(body: int) -> list[str]:
    """Names of the ten parameters of a body (from 0): "body 2 mx"."""
    return [f"body {body + 1} {name}" for name in INERTIAL_PARAMETER_NAMES]


def all_body_parameter_names(robot: RobotModel) -> list[str]:
    """Names of all parameters in the regressor's order."""
    return [name for body in range(robot.n) for name in body_parameter_names(body)]


def body_units(robot: RobotModel) -> np.ndarray:
    """Typical size of every parameter (n, 10) [kg], [kg m], [kg m^2]."""
    nominal = nominal_bodies(robot)
    mass = np.maximum(nominal[:, 0], _MIN_MASS_SHARE * nominal[:, 0].sum())
    gyration = np.sqrt(nominal[:, _MOMENT_ENTRIES].sum(axis=1) / (2.0 * mass))
    length = np.maximum(gyration, _MIN_GYRATION_RADIUS)
    powers = np.array([0] + [1] * 3 + [2] * 6)
    return np.asarray(mass[:, None] * length[:, None] ** powers)


def nominal_bodies(robot: RobotModel) -> np.ndarray:
    """Nominal inertial parameters (n, 10)."""
    return np.array([robot.arm.tree.bodies[j].inertial_parameters for j in robot.order])


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """Second moments of the mass about the joint's origin (..., 4, 4), mass last.

    Parameters
    ----------
    parameters : array (..., 10)
    """
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
    """The ten parameters (..., 10) of pseudo-inertias."""
    out = np.empty((*pseudo.shape[:-2], A_BODY))
    out[..., 0] = pseudo[..., 3, 3]
    out[..., 1:4] = pseudo[..., :3, 3]
    trace = np.trace(pseudo[..., :3, :3], axis1=-2, axis2=-1)
    for axis, k in enumerate(_MOMENT_ENTRIES):
        out[..., k] = trace - pseudo[..., axis, axis]
    for k, (row, column) in _PRODUCT_ENTRIES.items():
        out[..., k] = -pseudo[..., row, column]
    return out


def is_consistent(parameters: np.ndarray, units: np.ndarray) -> bool:
    """Whether bodies (n, 10) can be made of matter, up to rounding in their units."""
    return bool(
        np.linalg.eigvalsh(scaled_pseudo_inertia(parameters, units)).min()
        >= -_CONSISTENCY_TOLERANCE
    )


def make_consistent(bodies: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Bodies (n, 10) made such that they exist, off the border by a little of their size."""
    size, vectors = np.linalg.eigh(scaled_pseudo_inertia(bodies, units))
    size = np.maximum(size, _MIN_EIGENVALUE_RATIO * np.maximum(size[:, -1:], _MIN_EIGENVALUE_RATIO))
    lifted = (vectors * size[:, None, :]) @ vectors.swapaxes(1, 2)
    scales = pseudo_inertia_scales(units)
    return inertial_parameters(lifted * scales[:, :, None] * scales[:, None, :])


def pseudo_inertia_scales(units: np.ndarray) -> np.ndarray:
    """What rows of the pseudo-inertia are measured in (n, 4)."""
    root = np.sqrt(units[:, 0])
    length = units[:, 1] / units[:, 0]
    return np.column_stack([*(root * length,) * 3, root])


def scaled_pseudo_inertia(bodies: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Pseudo-inertias (n, 4, 4) of bodies (n, 10) over their scales."""
    scales = pseudo_inertia_scales(units)
    return np.asarray(pseudo_inertia(bodies) / (scales[:, :, None] * scales[:, None, :]))
