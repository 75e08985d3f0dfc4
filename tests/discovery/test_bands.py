"""Bands of fit and prediction depend on noise and motion of the training runs."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shipped_set import SHIPPED
from test_unseen_joints import recorded

from stiffopt.discovery import prediction
from stiffopt.discovery.comparison.bands import BANDS, choose_fit_band
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.prediction import _select_widest_adequate, choose_prediction_bands
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.recording.recording_set import load_recordings
from stiffopt.recording.run import RecordedRun


def _training() -> Training:
    return prepare_training(load_recordings(SHIPPED), Settings())


def _noisy(run: RecordedRun) -> RecordedRun:
    noise = 2e-3 * np.random.default_rng(5).standard_normal(run.position.shape)
    return replace(run, position=run.position + noise)


def test_fit_band_with_noisy_encoders_is_not_wider() -> None:
    """A quantised motion is derived twice at the highest band that its noise bears, not beyond."""
    recordings = load_recordings(SHIPPED)
    robot = RobotModel(recordings)
    clean = [recordings.open(entry) for entry in recordings.with_role("train")]
    usual = {"slow": 0.03, "fit": 12.0, "predict": 20.0}
    wide = choose_fit_band(robot, clean, **usual)
    assert {wide} <= set(BANDS)
    assert choose_fit_band(robot, [_noisy(run) for run in clean], **usual) <= wide


def test_prediction_bands_with_noisy_encoders_are_narrower(tmp_path: Path) -> None:
    """The inertia of the model carries the noise into the torque."""
    folder = recorded(tmp_path, [("train", (1.0, 1.3))], "nominal = { coulomb = [3.0, 2.5] }\n")
    training = prepare_training(load_recordings(folder), Settings(cutoff=12.0))
    noisy = replace(training, recorded=tuple(_noisy(run) for run in training.recorded))
    wide, narrow = (choose_prediction_bands(each, Extension()) for each in (training, noisy))
    assert max(narrow) < min(wide)


def test_prediction_bands_limit_only_elastic_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rigid joint beside an elastic one follows what its own torque bears out."""
    monkeypatch.setattr(
        prediction,
        "_torque_errors",
        lambda *given: np.outer(np.array(given[2]) ** -2.0, [1, 1]),
    )
    training = _training()
    first, second = training.constants.joints
    elastic = choose_prediction_bands(training, Extension())
    joints = (first, replace(second, chain=None))
    mixed = replace(training, constants=replace(training.constants, joints=joints))
    assert elastic[0] == elastic[1]
    assert choose_prediction_bands(mixed, Extension())[0] == elastic[0]
    assert choose_prediction_bands(mixed, Extension())[1] > elastic[1]


def test_bands_with_little_motion_keep_defaults() -> None:
    """Where nothing moves, the usual bands stay."""
    recordings = load_recordings(SHIPPED)
    run = recordings.open(recordings.with_role("train")[0])
    still = replace(run, position=np.tile(run.position[:1], (len(run.time), 1)))
    robot = RobotModel(recordings)
    assert choose_fit_band(robot, [still], slow=0.03, fit=12.0, predict=20.0) == 12.0
    training = _training()
    at_rest = replace(training, recorded=(replace(still, velocity=None),))
    bands = choose_prediction_bands(at_rest, Extension())
    assert set(bands) == {prediction.PREDICTION_CUTOFF}


def test_prediction_band_moves_steadily_with_the_errors() -> None:
    """The error of the next band falls from far above the adequate one to it."""
    tried, adequate = (20.0, 35.0, 60.0), 1.0 + prediction._MAX_WIDER_BAND_COST
    found = [
        _select_widest_adequate(tried, np.array([1.0, adequate - 0.02, error]))
        for error in adequate + np.geomspace(1.0, 1e-6, 60)
    ]
    assert found == sorted(found)
    assert found[0] < 36.0
    assert found[-1] == 60.0
    assert max(after / before for before, after in itertools.pairwise(found)) < 1.2
