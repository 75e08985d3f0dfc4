"""Nodes, quadrature and integration matrices on [0, 1], by Legendre polynomials."""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.polynomial import legendre


def power_from_values(nodes: np.ndarray) -> np.ndarray:
    """Matrix (m, m) from values at the nodes to power coefficients, lowest power first."""
    return np.linalg.inv(np.vander(np.asarray(nodes, dtype=float), increasing=True))


def bernstein_from_values(nodes: np.ndarray) -> np.ndarray:
    """Matrix (m, m): values at m nodes to the Bernstein coefficients on [0, 1].

    On [0, 1] the polynomial through the values lies between its least and largest coefficient.
    """
    return np.asarray(_bernstein_from_power(len(nodes)) @ power_from_values(nodes))


def bernstein_of_integral(nodes: np.ndarray) -> np.ndarray:
    """Matrix (m + 1, m): values at m nodes to Bernstein coefficients of the integral from 0."""
    m = len(nodes)
    power = power_from_values(nodes) / np.arange(1, m + 1)[:, None]
    return np.asarray(_bernstein_from_power(m + 1) @ np.vstack([np.zeros(m), power]))


def _bernstein_from_power(m: int) -> np.ndarray:
    """Matrix (m, m) from power to Bernstein coefficients of degree m - 1 on [0, 1]."""
    return np.array([[comb(j, k) / comb(m - 1, k) for k in range(m)] for j in range(m)])


def differentiation_matrix(nodes: np.ndarray) -> np.ndarray:
    """Matrix (m, m): slopes at the nodes of the polynomial through values at the nodes."""
    series = _legendre_from_values(nodes)
    slopes = legendre.legder(series, scl=2.0)
    return np.asarray(legendre.legvander(_to_symmetric_interval(nodes), len(slopes) - 1) @ slopes)


def integration_matrix(nodes: np.ndarray, ends: np.ndarray, times: int = 1) -> np.ndarray:
    """Matrix (len(ends), len(nodes)) of integrals from 0 to each end, repeated `times` times.

    The integrand is the polynomial through the values at the nodes.
    """
    integrals = legendre.legint(_legendre_from_values(nodes), m=times, lbnd=-1.0, scl=0.5)
    return np.asarray(
        legendre.legvander(_to_symmetric_interval(ends), len(nodes) - 1 + times) @ integrals
    )


def quadrature_weights(nodes: np.ndarray) -> np.ndarray:
    """Weights (m,) of the interpolatory quadrature over [0, 1]."""
    return integration_matrix(nodes, np.array([1.0])).ravel()


def interpolation_matrix(nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Matrix (len(points), len(nodes)): the polynomial through node values at other points."""
    values = legendre.legvander(_to_symmetric_interval(points), len(nodes) - 1)
    return np.asarray(values @ _legendre_from_values(nodes))


def _to_symmetric_interval(points: np.ndarray) -> np.ndarray:
    return 2.0 * np.atleast_1d(np.asarray(points, dtype=float)) - 1.0


def _legendre_from_values(nodes: np.ndarray) -> np.ndarray:
    # Well conditioned where the powers of the nodes are not.
    return np.linalg.inv(legendre.legvander(_to_symmetric_interval(nodes), len(nodes) - 1))
