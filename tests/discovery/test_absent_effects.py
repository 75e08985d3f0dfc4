"""Effects that the training runs make likelier absent than there have less of their values."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.diagnose import extension_of_estimate
from stiffopt.discovery.search.uncertainty import Estimate, estimate_parameters
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

DRY, DRAG = (LocatedEffect(effect=effect(name), joint=1) for name in ("coulomb", "viscous"))


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return prepare_training(load_recordings(SHIPPED), Settings()).comparison()


@pytest.fixture(scope="module")
def both(comparison: Comparison) -> Estimate:
    return estimate_parameters(comparison, [DRY, DRAG])


def amplitudes(estimate: Estimate) -> np.ndarray:
    return np.concatenate([each.amplitudes for each in estimate.effects])


def test_effect_without_its_value_leaves_the_fit_of_the_others(
    comparison: Comparison, both: Estimate
) -> None:
    alone = estimate_parameters(comparison, [DRY])
    found = both.shrunk(np.array([1.0, 0.0]))
    np.testing.assert_allclose(amplitudes(found)[1], 0.0, atol=1e-9)
    assert amplitudes(found)[0] == pytest.approx(amplitudes(alone)[0], rel=1e-6)
    count = len(alone.nuisance)
    np.testing.assert_allclose(found.values[:count], alone.values[:count], rtol=1e-6, atol=1e-9)
    assert abs(amplitudes(alone)[0] / amplitudes(both)[0] - 1.0) > 1e-4


def test_effect_keeps_a_share_of_its_value(both: Estimate) -> None:
    whole, some = amplitudes(both), amplitudes(both.shrunk(np.array([0.4, 1.0])))
    assert some[0] == pytest.approx(0.4 * whole[0], rel=1e-9)
    without = amplitudes(both.shrunk(np.array([0.0, 1.0])))
    assert some[1] - whole[1] == pytest.approx(0.6 * (without[1] - whole[1]), rel=1e-6)
    np.testing.assert_array_equal(amplitudes(both.shrunk(np.ones(2))), whole)


@pytest.mark.parametrize(("absence", "share"), [(0.0, 1.0), (0.5, 1.0), (0.75, 0.5), (1.0, 0.0)])
def test_extension_has_less_of_an_effect_that_may_be_absent(
    both: Estimate, absence: float, share: float
) -> None:
    finding = SimpleNamespace(located=DRY, absence=absence)
    found = extension_of_estimate(both, [finding])
    assert found.effects[0].amplitudes[0] == pytest.approx(share * amplitudes(both)[0], abs=1e-9)
