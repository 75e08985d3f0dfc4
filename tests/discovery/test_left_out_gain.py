"""Gain of findings in stretches left out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.channel_rows import ChannelNoise, elapsed_shares
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.design_matrix import DesignMatrix
from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search.cross_validation import FoldPredictions
from stiffopt.discovery.search.left_out_gain import (
    _probability_of_gain,
    _smooth_squares,
    left_out_gains,
)
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import MIN_HELD_OUT_SHARE
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


def test_gain_in_one_stretch_is_not_support() -> None:
    """The same gain in all of ten stretches, in one of them, and in none."""
    assert _probability_of_gain(np.array([3.0, 2.0, 4.0] * 3 + [3.0])) > 0.999
    assert _probability_of_gain(np.array([30.0] + [0.0] * 9)) < 0.9
    assert _probability_of_gain(np.zeros(10)) == 0.5
    assert _probability_of_gain(np.array([-3.0, -2.0, -4.0])) < 0.05


@pytest.mark.parametrize(("noise", "wave", "open_"), [(2.0, 0.0, 0.0), (1.0, 1.0, 0.5)])
def test_noise_above_the_stated_one_is_no_open_law(noise: float, wave: float, open_: float) -> None:
    """Squares of a slow wave in filtered noise, however large the noise is."""
    low_pass = ZeroPhaseFilter(rate=250.0, cutoff=12.0)
    draw = np.random.default_rng(3)
    time = np.arange(40_000) / 250.0
    samples = low_pass(noise * draw.normal(size=len(time)))[:: low_pass.step] / low_pass.noise_gain
    time = time[:: low_pass.step]
    residual = samples + wave * np.sin(2.0 * np.pi * 0.5 * time)
    run = SimpleNamespace(time=time, index=0, low_pass=low_pass)
    rows = SimpleNamespace(run=np.zeros(len(time)), sample_signal=lambda signal: signal(run))
    comparison: Any = SimpleNamespace(runs=[run], rows=rows)
    squares = _smooth_squares(comparison, residual, np.ones(len(time), dtype=bool))
    assert squares / len(time) == pytest.approx(open_, abs=0.12)


def test_present_effect_has_support_and_absent_none() -> None:
    comparison = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    there = LocatedEffect(effect=effect("coulomb"), joint=1)
    load = LocatedEffect(effect=effect("load_friction"), joint=0, shapes=(0.02,))
    present, absent = left_out_gains(comparison, [there, load])
    assert present.support > 0.9
    assert present.open_share < 0.1
    assert absent.support < 0.9
    assert absent.share < MIN_HELD_OUT_SHARE


def test_start_of_the_runs_that_is_left_out_gains_nothing() -> None:
    comparison = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    effects = [LocatedEffect(effect=effect(name), joint=1) for name in ("coulomb", "torque_offset")]
    before = left_out_gains(comparison, effects, 0.1)
    early = comparison.rows.sample_signal(lambda run: elapsed_shares(run.time)) < 0.1
    comparison.target[early & (comparison.rows.channel == 1)] += 50.0
    assert left_out_gains(comparison, effects, 0.1) == before
    assert left_out_gains(comparison, effects)[0].left_open > 10.0 * before[0].left_open


def test_few_parts_of_one_run_are_not_judged_in_larger_ones() -> None:
    """A bump that acts in 2 of 24 parts: the fit of five of six larger parts lacks it."""
    whole = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    single = DesignMatrix(whole.robot, whole.runs[:1], whole.noise, whole.tolerance)
    comparison = Comparison(single)
    bump = LocatedEffect(effect=effect("position_friction"), joint=0, shapes=(-1.346, 0.05))
    column = comparison.stack_columns([bump])[:, -1]
    comparison.target[:] += 24.0 * column / np.abs(column).max()
    (gain,) = left_out_gains(comparison, [bump], count=24)
    assert gain.share > 0.93


def test_noise_that_is_stated_too_small_leaves_nothing_open() -> None:
    """What the channels hold above the filter's band is noise, whatever the set states."""
    whole = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    noise = ChannelNoise(0.5 * whole.noise.torque, 0.5 * whole.noise.deflection)
    optimistic = Comparison(DesignMatrix(whole.robot, whole.runs, noise, whole.tolerance))
    there = LocatedEffect(effect=effect("coulomb"), joint=1)
    (gain,) = left_out_gains(optimistic, [there])
    assert gain.open_share < 0.1


def test_nominal_values_out_of_bounds_do_not_stand_for_an_effect_left_out() -> None:
    """A column alike with a narrow tolerance predicts as much as its bounds allow, no more."""
    draw = np.random.default_rng(8)
    shape = np.sin(np.linspace(0.0, 60.0, 3000))
    columns = np.column_stack([10.0 * shape, shape])
    target = 5.0 * shape + draw.normal(size=len(shape))
    prior, limits = np.array([0.02, 1.0]), np.array([4.0, np.inf])
    fold = np.arange(len(shape)) * 6 // len(shape)
    predictions = FoldPredictions(columns, target, prior, limits, fold)
    left = predictions.residual(np.array([True, False]))
    np.testing.assert_allclose(left, target - 0.8 * shape, atol=1e-6)
    both = predictions.residual()
    assert np.mean(both**2) == pytest.approx(1.0, abs=0.05)
