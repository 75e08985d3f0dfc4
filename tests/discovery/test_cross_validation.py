"""Findings that help only where they were fitted are no findings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.comparison import solve_boxed
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search.cross_validation import FoldPredictions
from stiffopt.discovery.search.left_out_gain import (
    LeftOutGain,
    _excess_share,
    drop_cancelling,
    select_predictive,
)
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


def test_present_effect_is_kept_and_absent_dropped() -> None:
    """More dry friction in joint 2 is in every run, load friction of joint 1 in none."""
    comparison = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    there = LocatedEffect(effect=effect("coulomb"), joint=1)
    load = LocatedEffect(effect=effect("load_friction"), joint=0, shapes=(0.02,))
    assert select_predictive(comparison, [load, there]) == [there]


def _gain(share: float, support: float) -> LeftOutGain:
    return LeftOutGain(
        removed=share, left_open=0.0, share=share, explained=share, channel=0, support=support
    )


@pytest.mark.parametrize(
    ("share", "support", "after_model", "stays"),
    [
        (0.03, 0.99, False, True),
        (0.03, 0.80, False, False),  # of one stretch alone
        (0.00, 0.99, False, False),  # next to nothing
        (0.60, 0.83, False, True),  # a drive at its limit in one stretch
        (0.03, 0.99, True, False),  # as little as a model errs from part to part
        (0.30, 0.99, True, True),
    ],
)
def test_finding_must_help_in_folds_left_out(
    share: float, support: float, after_model: bool, stays: bool
) -> None:
    """By the share of squares that it removes there, and by how evenly it does."""
    comparison: Any = SimpleNamespace(after_model=after_model, unseen=np.zeros(2, dtype=bool))
    law = LocatedEffect(effect=effect("load_friction"), joint=0, shapes=(0.02,))
    assert (_excess_share(comparison, law, _gain(share, support)) >= 0.0) == stays


def test_value_that_every_joint_has_needs_no_even_gain() -> None:
    comparison: Any = SimpleNamespace(after_model=False, unseen=np.zeros(2, dtype=bool))
    friction = LocatedEffect(effect=effect("coulomb"), joint=0)
    assert _excess_share(comparison, friction, _gain(0.002, 0.6)) >= 0.0
    assert _excess_share(comparison, friction, _gain(0.0, 0.4)) < 0.0


def test_cancelling_effects_are_dropped() -> None:
    """Nine times as much as there is to explain, less nearly as much again: neither is there."""
    time = np.linspace(0.0, 1.0, 200)
    shapes = {"viscous": time, "coulomb": 1.0 + 0.0 * time, "torque_offset": 1.0 + 0.01 * time}
    amplitudes = {"viscous": 1.0, "coulomb": -9.0, "torque_offset": 9.0}
    found = [LocatedEffect(effect=effect(name), joint=0) for name in shapes]
    comparison: Any = SimpleNamespace(
        target=time,
        rows=SimpleNamespace(channel=np.zeros(200, dtype=int)),
        effect_columns=lambda e: shapes[e.effect.name][:, None],
        fit=lambda effects: SimpleNamespace(
            amplitudes=lambda: np.array(
                [amplitudes[e.effect.name] if len(effects) == 3 else 0.5 for e in effects]
            )
        ),
    )
    kept = [e.effect.name for e in drop_cancelling(comparison, found)]
    assert "viscous" in kept
    assert len(kept) == 2  # alone, the other adds no more than there is


def test_values_beside_others_held_at_their_bounds_are_the_likeliest_ones() -> None:
    """Against a bounded least-squares solver, with columns left out as well."""
    draw = np.random.default_rng(5)
    columns, prior = draw.normal(size=(400, 8)), draw.uniform(0.05, 2.0, 8)
    target = columns @ draw.normal(size=8) + draw.normal(size=400)
    limits = np.array([1.0, 1.0, 1.0, 2.0, 2.0, *[np.inf] * 3])
    fold = np.arange(400) // 100
    predictions = FoldPredictions(columns, target, prior, limits, fold)
    for kept in (np.ones(8, dtype=bool), draw.uniform(size=8) < 0.7):
        left = predictions.residual(kept)
        own = columns[:, kept]
        for number in range(4):
            others = fold != number
            gram, moment = own[others].T @ own[others], own[others].T @ target[others]
            values = solve_boxed(gram, moment, prior[kept], limits[kept])
            expected = target[~others] - own[~others] @ values
            np.testing.assert_allclose(left[~others], expected, atol=1e-8)


def test_a_value_held_at_a_bound_is_let_go_where_others_at_theirs_press_it_inwards() -> None:
    """Columns that resemble one another, and values far beyond their bounds."""
    draw = np.random.default_rng(2)
    columns = draw.normal(size=(400, 3)) @ draw.normal(size=(3, 12)) + 0.2 * draw.normal(
        size=(400, 12)
    )
    target = 100.0 * columns @ draw.normal(size=12)
    prior, limits, fold = np.full(12, 5.0), np.full(12, 4.0), np.arange(400) // 100
    left = FoldPredictions(columns, target, prior, limits, fold).residual()
    for number in range(4):
        others = fold != number
        known = np.vstack([columns[others], np.diag(1.0 / prior)])
        goal = np.concatenate([target[others], np.zeros(12)])
        values = lsq_linear(known, goal, (-limits * prior, limits * prior), method="bvls").x
        expected = target[~others] - columns[~others] @ values
        np.testing.assert_allclose(left[~others], expected, rtol=1e-6, atol=1e-6)
