"""Tournament of models and perturbation ensemble on the shipped two-link set."""

from __future__ import annotations

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.judging.ensemble import _mean_share, recurrence
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.tournament import (
    CATALOGUE_MODEL,
    FRICTION_LINES,
    describe_tournament,
    hold_tournament,
)
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

# The set lacks dry friction of joint 2; friction of joint 1 is nominal.
PRESENT = LocatedEffect(effect=effect("coulomb"), joint=1)
ABSENT = LocatedEffect(effect=effect("load_friction"), joint=0, shapes=(0.02,))


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    start = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    return start.linearised_at(start.fit([PRESENT]))


def _selected(located: LocatedEffect) -> Selected:
    return Selected(located, 1.0, 1.0, 1.0, (), 1)


def test_present_effect_is_named_by_all_members_and_absent_by_none(comparison: Comparison) -> None:
    found = [_selected(PRESENT), _selected(ABSENT)]
    again = recurrence(comparison, found, None, free_bodies=False)
    np.testing.assert_array_equal(again, [1.0, 0.0])


@pytest.mark.parametrize(("width", "share"), [(1.0, 0.0), (5.0, 1.0)])
def test_only_a_rival_that_is_far_ahead_is_named_instead(
    comparison: Comparison, width: float, share: float
) -> None:
    """A bump as wide as the stroke is dry friction in all but name."""
    bump = LocatedEffect(effect=effect("position_friction"), joint=1, shapes=(0.5, width))
    beaten = Selected(bump, 1.0, 1.0, 1.0, ((PRESENT, 0.9),), 1)
    assert recurrence(comparison, [beaten], None, free_bodies=False) == [share]
    ahead = Selected(PRESENT, 1.0, 1.0, 1.0, ((bump, 0.1),), 1)
    assert recurrence(comparison, [ahead], None, free_bodies=False) == [1.0]


def test_model_with_the_present_effect_wins(comparison: Comparison) -> None:
    calibrated = LocatedEffect(effect=effect("viscous"), joint=0, calibrated=True)
    best, *others = hold_tournament(comparison, [calibrated], None, [calibrated, PRESENT])
    assert best.name == CATALOGUE_MODEL
    assert all(best.residual < each.residual for each in others)
    assert best.name in describe_tournament([best, *others])[0]


def test_friction_lines_win_over_an_effect_that_only_fits_noise(comparison: Comparison) -> None:
    calibrated = LocatedEffect(effect=effect("coulomb"), joint=1, calibrated=True)
    useless = [
        LocatedEffect(effect=effect("load_friction"), joint=j, shapes=(0.02,)) for j in (0, 1)
    ]
    found = hold_tournament(comparison, [calibrated], None, [calibrated, *useless])
    order = [each.name for each in found]
    assert order.index(FRICTION_LINES) < order.index(CATALOGUE_MODEL)


def test_kinds_of_perturbation_have_equal_weight() -> None:
    """Named without each of nine stretches, but not with free masses."""
    acts, yes, no = np.ones(1, dtype=bool), np.ones(1, dtype=bool), np.zeros(1, dtype=bool)
    share = _mean_share([[(yes, acts)] * 9, [(no, acts)], [(yes, ~acts)]], 1)
    np.testing.assert_array_equal(share, [0.5])
