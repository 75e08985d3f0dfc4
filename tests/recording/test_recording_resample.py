"""The uniform clock: exact where it can be, smooth where it must be, silent across gaps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recording_sets import motion

from stiffopt.errors import ProblemError
from stiffopt.recording.clean import clean
from stiffopt.recording.resample import uniform
from stiffopt.recording.run import Run
from stiffopt.recording.signals import Signals

SIGNALS = Signals(time="t", position=("q",), velocity=None, link_position=None, torque=("tau",))


def run_of(stamps: np.ndarray, position: np.ndarray, torque: np.ndarray) -> Run:
    columns = {"t": stamps, "q": position, "tau": torque}
    return clean(columns, SIGNALS, path=Path("r.npz"), name="r", file="r.npz", role="train")


def sine(stamps: np.ndarray) -> Run:
    noise = 0.01 * np.random.default_rng(8).normal(size=len(stamps))
    return run_of(stamps, np.sin(6.0 * stamps), 3.0 * np.cos(6.0 * stamps) + noise)


def test_a_uniform_clock_keeps_its_samples() -> None:
    run = sine(1.7e3 + 0.002 * np.arange(3000))
    even = uniform(run)
    assert not even.interpolated
    assert even.rate == pytest.approx(500.0, rel=1e-9)
    assert even.segments == (slice(0, 3000),)
    np.testing.assert_array_equal(even.position, run.position)
    np.testing.assert_array_equal(even.torque, run.torque)
    assert even.torque_valid.all()


def test_jittered_stamps_give_the_second_derivative_of_the_motion() -> None:
    """Differences of the samples as they are would be off by far more than the motion."""
    rng = np.random.default_rng(2)
    stamps = 0.01 * np.arange(1500) + 0.002 * rng.uniform(-1.0, 1.0, 1500)
    run = sine(stamps)
    even = uniform(run)
    assert even.interpolated
    true = -36.0 * np.sin(6.0 * even.time[1:-1])
    second = np.diff(even.position[:, 0], 2) * even.rate**2
    raw = np.diff(run.position[:, 0], 2) * even.rate**2 + 36.0 * run.position[1:-1, 0]
    assert np.sqrt(np.mean((second - true) ** 2)) < 0.1
    assert np.sqrt(np.mean(raw**2)) > 50.0
    assert even.position_valid.all()


def test_the_exact_mean_rate_of_rounded_stamps() -> None:
    """Stamps that are rounded to a microsecond must not drift off the clock."""
    stamps = np.round(np.arange(20000) / 1024.0, 6)
    even = uniform(sine(stamps))
    assert not even.interpolated
    assert even.rate == pytest.approx(1024.0, rel=1e-6)


def test_nothing_is_made_up_across_a_gap() -> None:
    keep = np.ones(2000, dtype=bool)
    keep[800:900] = False
    keep[1200] = False
    keep[1500:1503] = False
    stamps = 0.004 * np.arange(2000)
    run = sine(stamps[keep])
    even = uniform(run)
    assert len(even.segments) == 2
    first, second = even.segments
    np.testing.assert_allclose(even.time[first], stamps[:800], atol=1e-9)
    np.testing.assert_allclose(even.time[second], stamps[900:], atol=1e-9)
    # Single lost samples are bridged, but not counted as measured.
    lost = np.flatnonzero(~even.torque_valid[:, 0])
    np.testing.assert_allclose(even.time[lost], stamps[[1200, 1500, 1501, 1502]], atol=1e-9)
    np.testing.assert_allclose(even.position[:, 0], np.sin(6.0 * even.time), atol=1e-4)


def test_a_hole_in_one_channel_masks_that_channel_only() -> None:
    stamps = 0.002 * np.arange(3000)
    run = sine(stamps)
    torque = run.torque.copy()
    torque[1000:1500] = np.nan
    even = uniform(replace(run, torque=torque))
    assert len(even.segments) == 1
    assert np.flatnonzero(~even.torque_valid[:, 0]).tolist() == list(range(1000, 1500))
    assert even.position_valid.all()
    inside = even.torque[1000:1500, 0]
    assert np.isfinite(inside).all()
    assert np.ptp(np.diff(inside)) < 1e-9
    position = run.position.copy()
    position[1000:1500] = np.nan
    even = uniform(replace(run, position=position))
    assert [s.stop - s.start for s in even.segments] == [1000, 1500]


def test_another_rate() -> None:
    run = sine(0.002 * np.arange(3000))
    even = uniform(run, rate=300.0)
    np.testing.assert_allclose(np.diff(even.time), 1.0 / 300.0, rtol=1e-9)
    assert run.time[-1] - even.time[-1] < 1.0 / 300.0
    np.testing.assert_allclose(even.position[:, 0], np.sin(6.0 * even.time), atol=1e-7)


def test_results_go_back_to_the_stamps_of_the_file() -> None:
    rng = np.random.default_rng(2)
    stamps = 0.004 * np.arange(1000) + 0.0005 * rng.uniform(-1.0, 1.0, 1000)
    run = sine(np.sort(np.append(stamps, stamps[[3, 40]])))
    even = uniform(run)
    back = even.at(run.stamps, np.column_stack([even.position[:, 0], 2.0 * even.time]))
    assert back.shape == (1002, 2)
    assert np.isfinite(back).all()
    inside = (run.stamps >= even.time[0]) & (run.stamps <= even.time[-1])
    np.testing.assert_allclose(back[inside, 1], 2.0 * run.stamps[inside], atol=1e-9)
    np.testing.assert_allclose(back[inside, 0], np.sin(6.0 * run.stamps[inside]), atol=1e-4)
    assert even.at(run.stamps, even.time).shape == (1002,)


def test_runs_that_hold_no_motion_are_refused() -> None:
    run = sine(0.002 * np.arange(3000))
    with pytest.raises(ProblemError, match=r"r\.npz: joints \[1\] have no usable position"):
        uniform(replace(run, position=np.full_like(run.position, np.nan)))
    position = np.full_like(run.position, np.nan)
    position[::100] = run.position[::100]
    with pytest.raises(ProblemError, match="no piece between gaps has 8 samples"):
        uniform(replace(run, position=position))


def test_channels_that_a_joint_lacks_stay_nan() -> None:
    data = motion()
    signals = Signals(
        time="t",
        position=("q1", "q2"),
        velocity=("qd1", "qd2"),
        link_position=("ql1", ""),
        torque=("", "tau2"),
    )
    run = clean(data, signals, path=Path("r.npz"), name="r", file="r.npz", role="test")
    even = uniform(run)
    assert np.isnan(even.torque[:, 0]).all()
    assert not even.torque_valid[:, 0].any()
    assert even.torque_valid[:, 1].all()
    assert even.link_position is not None
    assert even.link_position_valid is not None
    assert even.link_position_valid.all(axis=0).tolist() == [True, False]
    np.testing.assert_array_equal(even.velocity, run.velocity)
