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
@pytest.mark.parametrize("exponent", [0.4, 1.0, 1.8])
def test_presliding_friction_matches_its_solution_of_each_step(reach, exponent):
    """The remainder z to the limit falls by dz/dd = -z^i/range while the travel keeps its side."""
    y, found = 0.0, [0.0]
    for travel in np.diff(LOAD):
        side, way, rest = np.sign(travel), abs(travel) / reach, 1.0 - exponent
        left = max(1.0 - y * side, 1e-9)
        left = (
            left * np.exp(-way) if rest == 0.0 else max(left**rest - rest * way, 0.0) ** (1 / rest)
        )
        y = side * (1.0 - left) if side else y
        found.append(y)
    ours = elastic._presliding_friction(LOAD, reach, exponent)
    np.testing.assert_allclose(ours, found, rtol=0.0, atol=1e-8)


def test_presliding_friction_is_continuous_in_its_exponent():
    one, near = (elastic._presliding_friction(LOAD, 3e-4, i) for i in (1.0, 1.0 + 1e-9))
    np.testing.assert_allclose(near, one, rtol=0.0, atol=1e-8)
