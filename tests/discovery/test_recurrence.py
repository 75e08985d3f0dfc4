"""Recurrences in one call against sample by sample."""

from types import SimpleNamespace

import numpy as np
import pytest

from stiffopt.discovery.catalogue import common, elastic

LOAD = 2e-5 * np.cumsum(np.random.default_rng(0).normal(size=800))
# It stands for a while, and turns round.
LOAD[200:260] = LOAD[200]
# Signals of a joint whose motor turns against its link.
TURNED = SimpleNamespace(motor_position=LOAD, link_position=np.zeros_like(LOAD))


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
    ours, slope = elastic._presliding_friction(TURNED, reach, exponent)
    np.testing.assert_allclose(ours, found, rtol=0.0, atol=1e-12)
    # Sliders that hold move with the travel.
    held = np.flatnonzero(np.diff(LOAD))
    change = np.diff(ours)[held] / np.diff(LOAD)[held]
    assert np.all(slope >= 0.0)
    assert np.all(change[slope[held + 1] == 1.0 / limits.mean()] > 0.0)


def test_presliding_friction_is_continuous_in_its_exponent():
    one, near = (elastic._presliding_friction(TURNED, 3e-4, i)[0] for i in (1.0, 1.0 + 1e-9))
    np.testing.assert_allclose(near, one, rtol=0.0, atol=1e-8)
