"""Friction reversal of a light drive between two samples, and bursts of a slow drive."""

import numpy as np
import pytest
from simulated_sets import simulated

from benchmarks.simulator import CaseSpec, write_case
from stiffopt.discovery.comparison.filtering import interpolate_motion
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.prepared_run import motor_cutoff
from stiffopt.discovery.judging.bursts import find_bursts
from stiffopt.discovery.settings import SIGN_SPEED, Settings
from stiffopt.discovery.signals import mean_sign, smooth_sign
from stiffopt.discovery.thresholds import BURST_RATIO
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

# A SCARA as its nominal model says, whose last joint is 20 times its noise in dry friction.
SCARA = {
    "robot": "scara4",
    "seed": 0,
    "tolerance": 0.0,
    "train": 2,
    "test": 1,
    "extrapolate": 0,
    "seconds": 3.0,
    "rate": 250.0,
    "substeps": 8,
    "smoothing": 0.2,
    "payload": 2.5,
}


# Samples a second, however many of which there are, the integration is the same [Hz].
RATES = (250.0, 1000.0)


def trained(folder, *effects, rate=250.0):
    spec = CaseSpec(effects=effects, **{**SCARA, "rate": rate, "substeps": int(2000.0 / rate)})
    return prepare_training(
        load_recordings(write_case(simulated(spec), folder / "set")), Settings()
    )


@pytest.fixture(scope="module", params=RATES)
def as_modelled(request, tmp_path_factory):
    return trained(tmp_path_factory.mktemp("modelled"), rate=request.param)


def test_bursts_exclude_friction_reversal(as_modelled):
    assert find_bursts(as_modelled, Extension()) is None


@pytest.mark.parametrize("rate", RATES)
def test_bursts_include_slow_drive_at_friction_reversal(tmp_path, rate):
    found = find_bursts(trained(tmp_path, ("slew_limit", 4, 0.3), rate=rate), Extension())
    assert found is not None
    assert found.channels == ("torque_4",)
    assert found.regressors == ("dtorque_4",)
    assert found.ratio > 2.0 * BURST_RATIO


def test_predicted_reversal_is_within_motion_band(as_modelled):
    """Friction jumps and the motor's acceleration answers: neither may stay alone."""
    ratios = []
    for run in as_modelled.runs:
        left = (run.torque - run.signals.drive_torque)[:, 3]
        used = run.torque_used[:, 3]
        ratios.append(np.sqrt(np.mean(left[used] ** 2)) / as_modelled.noise.channels.torque[3])
    assert max(ratios) < 1.15


def test_motor_cutoff_is_limited_by_encoder_noise(as_modelled):
    run, robot = as_modelled.recorded[0], as_modelled.robot
    assert motor_cutoff(robot, run.position, 4e-3) == pytest.approx(90.0)
    assert 90.0 < motor_cutoff(robot, run.position, 1e-3) <= 150.0
    noise = 2e-5 * np.random.default_rng(1).standard_normal(run.position.shape)
    assert motor_cutoff(robot, run.position + noise, 1e-3) == 60.0
    assert motor_cutoff(robot, run.position + noise, 1e-2) == pytest.approx(36.0)


def test_interpolate_motion_bridges_missing_sample():
    time = 4e-3 * np.arange(200.0)
    motion = np.column_stack([np.cos(7.0 * time), 0.1 * time**2])
    gappy = motion.copy()
    gappy[[50, 120, 121], 0] = np.nan
    np.testing.assert_allclose(interpolate_motion(time, gappy, time), motion, atol=1e-6)
    left_out = np.delete(np.arange(200), [0, 30, 90])
    np.testing.assert_allclose(
        interpolate_motion(time[left_out], motion[left_out], time)[1:], motion[1:], atol=1e-6
    )
    assert np.all(np.isnan(interpolate_motion(time, np.full((200, 1), np.nan), time)))
    # A motor that stops, stands still and goes on: its stand was taken out.
    stopped = np.interp(time, [0.0, 0.3, 0.5, 0.8], [0.0, 0.3, 0.3, 0.6])[:, None]
    gappy = stopped.copy()
    gappy[80:120] = np.nan
    np.testing.assert_allclose(interpolate_motion(time, gappy, time), stopped, atol=1e-12)


def test_mean_sign_is_mean_over_sample_period():
    # Turns at 0.3 of the step after the sixth sample, far faster than signs are smooth.
    velocity = 100.0 * SIGN_SPEED * (np.arange(12.0) - 6.3)[:, None]
    sign = mean_sign(velocity)[:, 0]
    np.testing.assert_allclose(sign[:6], -1.0, atol=1e-12)
    np.testing.assert_allclose(sign[7:], 1.0, atol=1e-12)
    # Of the sixth sample's time, from half a step before to half a step after it, 0.8 lie before.
    assert sign[6] == pytest.approx(-0.6, abs=1e-3)


def test_mean_sign_of_slow_motion_is_smooth_sign():
    velocity = 0.4 * SIGN_SPEED * np.sin(0.01 * np.arange(400.0))[:, None]
    np.testing.assert_allclose(mean_sign(velocity)[1:-1], smooth_sign(velocity)[1:-1], atol=1e-5)
    still = np.zeros((5, 2))
    assert np.all(mean_sign(still) == 0.0)
    assert mean_sign(velocity[:2]).shape == (2, 1)
