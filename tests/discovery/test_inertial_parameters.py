"""Free inertial parameters: physical consistency, and evidence of added columns."""

from __future__ import annotations

import numpy as np
import pytest

from stiffopt.discovery.comparison.evidence import AddedColumnsPosterior, BlockSums, posterior
from stiffopt.discovery.comparison.inertial_parameters import (
    inertial_parameters,
    is_consistent,
    likeliest_consistent_bodies,
    pseudo_inertia,
)

# A rod of 2 kg along x from its joint's origin: 0.4 m long, its inertia about the origin.
ROD = np.array([[2.0, 0.4, 0.0, 0.0, 0.002, 0.0, 0.11, 0.0, 0.0, 0.11]])
UNITS = np.array([[2.0, *[0.4] * 3, *[0.08] * 6]])


def test_pseudo_inertia_round_trip() -> None:
    """There and back; the mass stands last, first moments beside it."""
    parameters = np.random.default_rng(1).standard_normal((3, 10))
    there = pseudo_inertia(parameters)
    np.testing.assert_allclose(inertial_parameters(there), parameters, atol=1e-14)
    np.testing.assert_allclose(there, there.swapaxes(1, 2))
    np.testing.assert_allclose(there[:, 3, 3], parameters[:, 0])


def test_is_consistent_accepts_and_refuses_bodies() -> None:
    """A rod exists; with less inertia than its centre of mass alone needs it does not."""
    assert is_consistent(ROD, UNITS)
    light = ROD.copy()
    light[0, 9] = 0.05
    assert not is_consistent(light, UNITS)


def test_likeliest_consistent_bodies_are_consistent_and_optimal() -> None:
    """Data that ask for a negative moment of inertia are followed as far as matter allows."""
    gram = np.diag([1.0, *[1e4] * 3, *[1e6] * 6, 1.0])
    wanted = np.zeros(11)
    wanted[9] = -0.2
    wanted[10] = 5.0
    found = likeliest_consistent_bodies(
        gram, gram @ wanted, slice(0, 10), ROD, UNITS, np.full(11, 3.0)
    )
    bodies = ROD + found[:10]
    assert is_consistent(bodies, UNITS)

    def cost(x: np.ndarray) -> float:
        return float(0.5 * x @ gram @ x - x @ gram @ wanted)

    least = np.zeros(11)
    least[9] = 0.4**2 / 2.0 - ROD[0, 9] + 0.002  # nothing but the mass at its place, by hand
    least[10] = 3.0
    assert found[10] == pytest.approx(3.0)
    assert cost(found) <= cost(least) + 1e-6


def test_bodies_at_the_border_of_consistency_are_found_from_any_amount_of_data() -> None:
    """Long recordings that ask for negative masses press the eigenvalues below rounding."""
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((40, 20))
    gram = 1e13 * columns.T @ columns + np.eye(20)
    wanted = np.tile([-3.0, *[0.1] * 3, *[-0.2] * 6], 2)
    bodies, units = np.vstack([ROD, ROD]), np.vstack([UNITS, UNITS])
    found = likeliest_consistent_bodies(
        gram, gram @ wanted, slice(0, 20), bodies, units, np.full(20, np.inf)
    )
    assert is_consistent(bodies + found.reshape(2, 10), units)
    assert np.all(np.isfinite(found))


def test_added_columns_posterior_matches_full_posterior() -> None:
    """Posterior, evidence and density of blocks left out are those of a fit of all at once."""
    rng = np.random.default_rng(2)
    base, added = rng.standard_normal((120, 6)), rng.standard_normal((120, 3))
    target, block = rng.standard_normal(120) + added[:, 0], np.repeat(np.arange(4), 30)
    prior = rng.uniform(0.1, 2.0, 6)
    sums = BlockSums(base, target, block, 4)
    kept = np.array([0, 2])
    beside = AddedColumnsPosterior(sums.own, prior)
    short = beside.added(sums.added_sums(added), kept)
    columns = np.column_stack([base, added[:, kept]])
    whole = posterior(BlockSums(columns, target, block, 4).own, np.concatenate([prior, np.ones(2)]))
    np.testing.assert_allclose(short.mean, whole.mean[6:])
    np.testing.assert_allclose(short.base(), whole.mean[:6])
    np.testing.assert_allclose(short.covariance, whole.covariance[6:, 6:])
    assert short.log_evidence == pytest.approx(whole.log_evidence)
    predicted = beside.log_predictive(sums.added_sums(added), kept)
    assert predicted == pytest.approx(whole.log_predictive)
