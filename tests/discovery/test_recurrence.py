"""Recurrences in one call against sample by sample."""

import numpy as np
import pytest

from stiffopt.discovery.catalogue import common, elastic

LOAD = 2e-5 * np.cumsum(np.random.default_rng(0).normal(size=800))
# It stands for a while, and turns round.
LOAD[200:260] = LOAD[200]


@pytest.mark.parametrize("kept", [0.0, 0.2, 0.97, 1.0])
def test_first_order_lag_matches_recurrence(kept):
    slow = [LOAD[0]]
    for value in LOAD[1:]:
        slow.append(value + (slow[-1] - value) * kept)
    np.testing.assert_allclose(common.first_order_lag(LOAD, kept), slow, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("reach", [2e-5, 3e-4, 5e-3])
@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.0])
def test_presliding_friction_matches_sliders_sample_by_sample(reach, exponent):
    limits = reach * ((np.arange(10) + 0.5) / 10) ** exponent
    strain, found = np.zeros(10), []
    for travel in np.diff(LOAD, prepend=LOAD[:1]):
        strain = np.maximum(np.minimum(strain + travel, limits), -limits)
        found.append(strain.sum() / limits.sum())
    ours = elastic._presliding_friction(LOAD, reach, exponent)
    np.testing.assert_allclose(ours, found, rtol=0.0, atol=1e-12)


def test_presliding_friction_is_continuous_in_its_exponent():
    one, near = (elastic._presliding_friction(LOAD, 3e-4, i) for i in (1.0, 1.0 + 1e-9))
    np.testing.assert_allclose(near, one, rtol=0.0, atol=1e-8)
