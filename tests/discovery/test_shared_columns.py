"""Columns of a comparison: computed together, kept once, shared by the searches of one training."""

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import (
    Extension,
    LocatedEffect,
    channel_changes,
)
from stiffopt.discovery.judging.unexplained import _wave_power
from stiffopt.discovery.search import tournament
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

PAYLOAD = LocatedEffect(effect=effect("payload"))
FRICTION = LocatedEffect(effect=effect("coulomb"), joint=1)


@pytest.fixture(scope="module")
def training():
    return prepare_training(load_recordings(SHIPPED), Settings())


def test_contributions_respond_together_as_alone(training):
    run = training.runs[0]
    assert run.vibration is not None
    units = np.eye(len(PAYLOAD.effect.amplitudes))
    every = [PAYLOAD.contribution(run, unit) for unit in units]
    every.append(FRICTION.contribution(run, [1.0]))
    together = channel_changes(every, run)
    for each, (torque, deflection) in zip(every, together, strict=True):
        ((alone, moved),) = channel_changes([each], run)
        np.testing.assert_array_equal(torque, alone)
        assert (deflection is None) == (moved is None)
        if moved is not None:
            np.testing.assert_array_equal(deflection, moved)
    # Friction of a motor moves no link.
    assert together[-1][1] is None


def test_rows_of_a_model_equal_its_stacked_columns(training):
    comparison = training.comparison()
    effects = [FRICTION, PAYLOAD]
    columns = comparison.stack_columns(effects)
    values = np.random.default_rng(0).normal(size=columns.shape[1])
    rows = comparison.model_rows(effects, values)
    np.testing.assert_allclose(rows, columns @ values, atol=1e-12 * np.max(np.abs(rows)))


def test_searches_of_a_training_share_nominal_columns_and_no_linearisation(training):
    first, second = training.comparison(), training.comparison()
    assert first.columns._cached_nominal is second.columns._cached_nominal
    moved = first.linearised_at(first.fit([PAYLOAD]))
    assert moved.columns is not first.columns
    assert second.columns.linearised_at(Extension()) is second.columns


def test_released_steps_are_recomputed_alike(training):
    vibration = training.runs[0].vibration
    torque = np.random.default_rng(1).normal(size=(3, *vibration.stiffness.shape))
    before = vibration.response.moved(torque)
    vibration.response.release_steps()
    for known, again in zip(before, vibration.response.moved(torque), strict=True):
        np.testing.assert_array_equal(again, known)


def test_power_of_waves_is_that_of_a_fit_of_each():
    random = np.random.default_rng(2)
    time, frequencies = np.arange(200) * 0.01, np.array([0.7, 3.0, 50.0])
    residual = random.normal(size=200) + np.cos(2.0 * np.pi * 3.0 * time)
    power = _wave_power(residual, time, frequencies)
    for own, f in zip(power, frequencies, strict=True):
        wave = np.column_stack([np.sin(2.0 * np.pi * f * time), np.cos(2.0 * np.pi * f * time)])
        left = residual - wave @ np.linalg.lstsq(wave, residual, rcond=1e-8)[0]
        assert own == pytest.approx(np.sum(residual**2) - np.sum(left**2), rel=1e-9)


@pytest.mark.parametrize("excess", [[2e-13, 0.0], [0.03, -0.02], [0.03, 0.02]])
def test_models_that_predict_equally_well_keep_their_order(training, monkeypatch, excess):
    """That of the catalogue gives way to what is better by more than a standard error."""
    calibrated = LocatedEffect(effect=effect("viscous"), joint=0, calibrated=True)
    plain = np.full(2, 0.5)
    squares = iter([plain + excess, plain, plain + 1e-15])
    monkeypatch.setattr(tournament, "_squares_left_out", lambda *_: next(squares))
    found = tournament.hold_tournament(training.comparison(), [calibrated], None, [FRICTION])
    names = ["effects of the catalogue", "friction lines", "base parameters"]
    clear = excess[-1] > 0.0
    assert [each.name for each in found] == (names[1:] + names[:1] if clear else names)
