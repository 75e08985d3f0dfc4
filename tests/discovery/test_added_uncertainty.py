"""What its own deviation does not tell from nothing is no finding."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.judging.added_uncertainty import Found, drop_insignificant
from stiffopt.discovery.search import cross_validation
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


@pytest.mark.parametrize(
    ("calibrated", "share", "stays"), [(False, 0.0, 0), (False, 0.1, 1), (True, 0.0, 1)]
)
def test_finding_without_explained_share_is_dropped(
    calibrated: bool, share: float, stays: int
) -> None:
    """However sure its value is."""
    comparison = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    friction = LocatedEffect(effect=effect("coulomb"), joint=1, calibrated=calibrated)
    there = Selected(friction, 1.0, 1.0, 1.0, (), 1)

    def estimated(found: Sequence[Selected]) -> Found:
        return tuple(found), estimate_parameters(comparison, [s.located for s in found])

    kept, _ = drop_insignificant([there], estimated, lambda found: [share] * len(found))
    assert len(kept) == stays


def test_position_effect_passed_once_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its shapes were fitted to that moment, and no other part could contradict them."""
    place = LocatedEffect(effect=effect("position_friction"), joint=0, shapes=(0.5, 0.1))
    parts = np.repeat(np.arange(6), 50)
    once = np.where(parts == 3, 1.0, 0.001)
    twice = np.where((parts == 3) | (parts == 5), 1.0, 0.001)
    monkeypatch.setattr(cross_validation, "number_folds", lambda *_: parts)
    for column, met in ((once, False), (twice, True)):
        comparison: Any = SimpleNamespace(effect_columns=lambda _, c=column: c[:, None])
        assert cross_validation._drop_single_fold_shapes(comparison, [place]) == (
            [place] if met else []
        )
    # What has no shape was not fitted to that moment.
    plain = LocatedEffect(effect=effect("torque_offset"), joint=0)
    comparison = SimpleNamespace(effect_columns=lambda _: once[:, None])
    assert cross_validation._drop_single_fold_shapes(comparison, [plain]) == [plain]
