"""Modes of a large arm: explained where the nominal model has them."""

import pytest
from simulated_sets import diagnosed

from benchmarks.simulator import CaseSpec

# It swings at 10 to 12 Hz, and is excited by sharp corners.
HEALTHY = CaseSpec(
    robot="big6", seed=5, train=3, test=1, extrapolate=0, seconds=5.0, rate=250.0, substeps=8,
    payload=10.0, smoothing=0.2,
)  # fmt: skip


@pytest.mark.slow
def test_known_mode_in_band_is_no_finding():
    found = diagnosed(HEALTHY)
    assert found.verdict == "nothing_missing"
    assert found.nrmse("test")[1] < 1.15
    assert found.modes
    assert not any(mode.is_shifted for mode in found.modes)
