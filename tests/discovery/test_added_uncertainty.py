"""What its own deviation does not tell from nothing is no finding."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.judging.added_uncertainty import Found, drop_insignificant
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import estimate_parameters
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


@pytest.mark.parametrize(
    ("calibrated", "doubt", "stays"),
    [
        (False, 0.4, True),
        (False, 0.7, False),  # 1.4 deviations from nothing
        (True, 1.5, True),  # part of the model, however small
    ],
)
def test_finding_within_its_deviation_is_dropped(
    calibrated: bool, doubt: float, stays: bool
) -> None:
    """Whatever makes it so large: half the band, other runs, what a model left open."""
    comparison = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    friction = LocatedEffect(effect=effect("coulomb"), joint=1, calibrated=calibrated)
    there = Selected(friction, 1.0, 1.0, 1.0, (), 1)

    def estimated(found: Sequence[Selected]) -> Found:
        known = estimate_parameters(comparison, [s.located for s in found])
        values = known.values[len(known.nuisance) :]
        return tuple(found), known.doubted(doubt * values)

    kept, known = drop_insignificant([there], estimated)
    assert kept == ((there,) if stays else ())
    assert [e.located for e in known.effects] == [s.located for s in kept]
