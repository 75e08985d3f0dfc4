"""What half the band says otherwise counts beyond what it knows less."""

from __future__ import annotations

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect
from stiffopt.discovery.judging import added_uncertainty
from stiffopt.discovery.judging.added_uncertainty import (
    add_band_deviation,
    excess_difference,
    half_band_comparison,
)
from stiffopt.discovery.search.uncertainty import estimate_parameters
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


@pytest.mark.parametrize(("wrong", "least", "most"), [(0.0, 0.4, 0.55), (1.0, 0.9, 1.0)])
def test_difference_of_nested_means_is_chance(wrong: float, least: float, most: float) -> None:
    """The same law in both: of their difference half is taken for chance; another one: little."""
    draw = np.random.default_rng(3)
    samples = draw.normal(size=(4000, 40))
    samples[:, :20] += wrong
    away = samples[:, :20].mean(axis=1) - samples.mean(axis=1)
    found = excess_difference(away, np.full(4000, 1 / 20), np.full(4000, 1 / 40))
    assert least < np.sum(found**2) / np.sum(away**2) < most


@pytest.mark.parametrize("after_model", [False, True])
def test_correct_law_has_small_band_deviation(
    after_model: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dry friction is the same in every band; chance counts where a model was started from."""
    training = prepare_training(load_recordings(SHIPPED), Settings())
    comparison = training.comparison()
    comparison.after_model = after_model
    asked: list[np.ndarray] = []

    def seen(away: np.ndarray, less: np.ndarray, more: np.ndarray) -> np.ndarray:
        asked.append(away)
        return excess_difference(away, less, more)

    monkeypatch.setattr(added_uncertainty, "excess_difference", seen)
    there = LocatedEffect(effect=effect("coulomb"), joint=1)
    known = estimate_parameters(comparison, [there])
    found = comparison.extension_of(comparison.fit([there]))
    half = half_band_comparison(training, comparison, found)
    doubted = add_band_deviation(comparison, half, known)
    constants = there.constants(training.constants)
    before, after = (each.parameters(0, constants)["dFc"] for each in (known, doubted))
    assert after[0] == before[0]
    assert before[1] <= after[1] < 1.5 * before[1]
    assert bool(asked) == after_model


def test_half_band_reads_torques_with_effects_found() -> None:
    """A reading of another joint's torque has its friction in every band."""
    training = prepare_training(load_recordings(SHIPPED), Settings())
    friction = LocatedEffect(effect=effect("coulomb"), joint=1)
    reading = LocatedEffect(effect=effect("crosstalk"), joint=0, link=0, shapes=(2.0,))
    comparison = training.comparison()
    comparison = comparison.linearised_at(comparison.fit([friction]))
    found = comparison.extension_of(comparison.fit([friction]))
    half = half_band_comparison(training, comparison, found)
    without = half_band_comparison(training, comparison, Extension())
    assert half is not None
    assert without is not None
    # In units of the noise, which differs between the bands: over those of a constant torque.
    constant = LocatedEffect(effect=effect("torque_offset"), joint=0)
    sizes = [
        np.linalg.norm(each.effect_columns(reading)) / np.linalg.norm(each.effect_columns(constant))
        for each in (half, without)
    ]
    assert sizes[1] < 0.97 * sizes[0]
