"""Shapes that were fitted beside an effect that has gone start again where they cannot be."""

from __future__ import annotations

from dataclasses import replace

import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search.candidates import Candidate, Scorer
from stiffopt.discovery.search.joint_fit import fit_jointly
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


def test_impossible_shapes_are_fitted_from_initial_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    comparison = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    friction = effect("position_friction")
    impossible = LocatedEffect(effect=friction, joint=1, shapes=(0.111, 0.222))
    plain = Scorer.score

    def score(scorer: Scorer, located: LocatedEffect, price: float = 0.0) -> Candidate | None:
        return None if located.shapes == impossible.shapes else plain(scorer, located, price)

    monkeypatch.setattr(Scorer, "score", score)
    _, (found,) = fit_jointly(comparison, [impossible])
    assert found.same_place(impossible)
    assert found.shapes != impossible.shapes
    own = Scorer(comparison).score(found)
    # As good as any of the shapes that a search starts from.
    starts = [
        plain(Scorer(comparison), replace(impossible, shapes=(place, width)))
        for place in (-0.5, 0.0, 0.5)
        for width in (0.12, 0.3, 0.7)
    ]
    assert own is not None
    assert all(each is None or own.evidence >= each.evidence - 5.0 for each in starts)
