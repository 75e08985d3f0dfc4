"""Nodes and matrices against known values and exact integrals of monomials."""

import casadi as ca
import numpy as np
import pytest

from stiffopt.transcription import grid
from stiffopt.transcription.schemes import Radau


def radau_nodes(count: int) -> np.ndarray:
    return np.array(ca.collocation_points(count, "radau"))


def test_radau_nodes_equal_known_values():
    inner = np.array([4 - np.sqrt(6), 4 + np.sqrt(6)]) / 10
    assert Radau.control_nodes == pytest.approx([*inner, 1.0], abs=1e-15)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 9])
def test_radau_quadrature_is_exact_to_its_degree(count):
    nodes = radau_nodes(count)
    weights = grid.quadrature_weights(nodes)
    for power in range(2 * count - 1):
        assert weights @ nodes**power == pytest.approx(1 / (power + 1), abs=1e-13)
    if count <= 5:  # beyond, the error of the next power drowns in rounding
        assert abs(weights @ nodes ** (2 * count - 1) - 1 / (2 * count)) > 1e-7


def test_differentiation_inverts_integration():
    nodes = np.append(0.0, radau_nodes(4))
    values = nodes**4 - 2 * nodes**2 + 3
    slopes = grid.differentiation_matrix(nodes) @ values
    assert slopes == pytest.approx(4 * nodes**3 - 4 * nodes, abs=1e-12)
    assert grid.integration_matrix(nodes, nodes) @ slopes == pytest.approx(values - 3, abs=1e-12)


def test_double_integration_is_exact():
    nodes, ends = radau_nodes(3), np.array([0.25, 1.0])
    twice = grid.integration_matrix(nodes, ends, times=2) @ nodes**2
    assert twice == pytest.approx(ends**4 / 12, abs=1e-14)


def test_interpolation_reproduces_polynomials():
    nodes, points = radau_nodes(3), np.array([-0.2, 0.0, 0.7])
    assert grid.interpolation_matrix(nodes, points) @ nodes**2 == pytest.approx(points**2)
