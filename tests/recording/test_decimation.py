"""Long recordings: means of a few samples in the place of each few."""

from __future__ import annotations

import numpy as np
import pytest

from stiffopt.recording.decimation import decimate_run, decimation_factor, describe_decimation
from stiffopt.recording.run import RecordedRun


def run_of(time: np.ndarray) -> RecordedRun:
    rng = np.random.default_rng(0)
    position = np.column_stack([np.sin(time), 0.1 * time])
    return RecordedRun(
        name="a",
        file="a.npz",
        role="train",
        number=0,
        session_time=None,
        temperature=None,
        stamps=time,
        time=time,
        position=position,
        velocity=None,
        link_position=position - 1e-3,
        torque=rng.standard_normal(position.shape),
        faults=(),
    )


def test_short_recordings_are_not_decimated() -> None:
    usual = run_of(np.arange(5000) / 500.0)
    assert decimation_factor([usual] * 8) == 1
    assert decimate_run(usual, 1) is usual


def test_ten_minutes_at_a_kilohertz_are_decimated() -> None:
    """Motion stays at its stamps, white noise falls by the root of the number."""
    long = run_of(np.arange(480_000) / 1000.0)
    every = decimation_factor([long])
    assert every == 3
    thin = decimate_run(long, every)
    assert set(thin.time) <= set(long.stamps)
    assert thin.step == pytest.approx(0.003)
    np.testing.assert_allclose(thin.position[:, 0], np.sin(thin.time), atol=1e-6)
    assert thin.torque.std() == pytest.approx(3.0**-0.5, rel=0.01)
    assert thin.link_position is not None
    assert "333 Hz" in describe_decimation([long], every)


def test_decimated_rate_has_a_minimum() -> None:
    assert decimation_factor([run_of(np.arange(400_000) / 250.0)]) == 1
    assert decimation_factor([run_of(np.arange(4_000_000) / 1000.0)]) == 5


def test_means_over_gaps_are_removed() -> None:
    time = np.arange(90) / 1000.0
    time[31:] += 0.5
    thin = decimate_run(run_of(time), 3)
    assert len(thin.time) == 29
    assert not np.any((thin.time > 0.031) & (thin.time < 0.5))
    assert not np.isclose(thin.time, time[31]).any()
