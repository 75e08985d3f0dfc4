"""Bands of fit and prediction depend on noise and motion of the training runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.comparison import bands
from stiffopt.discovery.comparison.bands import BANDS, choose_bands
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.recording.recording_set import load_recordings
from stiffopt.recording.run import RecordedRun


def test_choose_bands_with_noisy_encoders_are_narrower() -> None:
    """A quantised motion is derived twice at the highest band that its noise bears, not beyond."""
    recordings = load_recordings(SHIPPED)
    robot = RobotModel(recordings)
    clean = [recordings.open(entry) for entry in recordings.with_role("train")]
    rng = np.random.default_rng(5)

    def noisy(run: RecordedRun) -> RecordedRun:
        return replace(run, position=run.position + 2e-3 * rng.standard_normal(run.position.shape))

    usual = {"slow": 0.03, "fit": 12.0, "predict": 20.0}
    wide = choose_bands(robot, clean, **usual)
    narrow = choose_bands(robot, [noisy(run) for run in clean], **usual)
    assert {wide.fit, *wide.predict} <= set(BANDS)
    assert max(narrow.predict) < min(wide.predict)
    assert narrow.fit <= wide.fit


def test_choose_bands_limits_only_elastic_joints(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A rigid joint beside an elastic one follows what its own torque bears out."""
    recordings = load_recordings(SHIPPED)
    robot = RobotModel(recordings)
    runs = [recordings.open(entry) for entry in recordings.with_role("train")]
    monkeypatch.setattr(
        bands, "_cross_validation_errors", lambda *given: np.full(2, given[2] ** -2.0)
    )
    usual = {"slow": 0.03, "fit": 6.0, "predict": 6.0}
    assert choose_bands(robot, runs, **usual).predict == (6.0, 6.0)
    first, second = robot.constants.joints
    rigid = replace(second, chain=None)
    robot.constants = replace(robot.constants, joints=(first, rigid))
    assert choose_bands(robot, runs, **usual).predict == (6.0, 35.0)


def test_choose_bands_with_little_motion_keeps_defaults() -> None:
    """Where nothing moves, the usual bands stay."""
    recordings = load_recordings(SHIPPED)
    robot = RobotModel(recordings)
    run = recordings.open(recordings.with_role("train")[0])
    still = replace(run, position=np.tile(run.position[:1], (len(run.time), 1)))
    chosen = choose_bands(robot, [still], slow=0.03, fit=12.0, predict=20.0)
    assert (chosen.fit, set(chosen.predict)) == (12.0, {20.0})
