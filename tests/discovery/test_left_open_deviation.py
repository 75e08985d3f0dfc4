"""What a model leaves of its own recordings is no comfort to what is found beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect
from stiffopt.discovery.judging.left_open import add_left_open_deviation, build_left_open
from stiffopt.discovery.search.uncertainty import estimate_parameters
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.recording.recording_set import load_recordings

COULOMB = effect("coulomb")
THERE = LocatedEffect(effect=COULOMB, joint=1)


@pytest.fixture(scope="module")
def training() -> Training:
    found = prepare_training(load_recordings(SHIPPED), Settings(), vibrating=False)
    return replace(found, free_bodies=True)


def _leaning(training: Training, known: float) -> float:
    """Of dry friction of the second joint, where a model has so much of it already."""
    model = Extension(effects=(EstimatedEffect(located=THERE, amplitudes=(known,)),))
    return build_left_open(training, model, (COULOMB,)).leanings.get(THERE.label, (0.0,))[0]


def test_leanings_of_either_sign_have_their_size(training: Training) -> None:
    """Beyond the bounds of what could be found, too: no friction drives a joint."""
    lacking = _leaning(training, 0.0)
    assert lacking > 0.3
    assert _leaning(training, 2.0 * lacking) == pytest.approx(-lacking, rel=0.02)
    assert abs(_leaning(training, lacking)) < 0.02 * lacking


def test_leaning_adds_one_deviation(training: Training) -> None:
    comparison = training.comparison()
    found = estimate_parameters(comparison.linearised_at(comparison.fit([THERE])), [THERE])
    (value, sd) = found.parameters(0, comparison.constants.joints[1])["dFc"]
    doubted = add_left_open_deviation(replace(training, leanings={THERE.label: (-0.3,)}), found)
    (same, wider) = doubted.parameters(0, comparison.constants.joints[1])["dFc"]
    assert same == value
    assert wider == pytest.approx(np.hypot(sd, 0.3))
    assert add_left_open_deviation(training, found).parameters(
        0, comparison.constants.joints[1]
    ) == {"dFc": (value, sd)}
