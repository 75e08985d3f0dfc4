"""Findings that help only where they were fitted are no findings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.judging.friction_refit import _apply_steps, _MovingSamples, refit_friction
from stiffopt.discovery.search import uncertainty
from stiffopt.discovery.search.cross_validation import (
    _excess_share,
    drop_cancelling,
    select_predictive,
)
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import estimate_parameters
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import MIN_HELD_OUT_SHARE
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


def test_present_effect_is_kept_and_absent_dropped() -> None:
    """More dry friction in joint 2 is in every run, load friction of joint 1 in none."""
    comparison = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    there = LocatedEffect(effect=effect("coulomb"), joint=1)
    load = LocatedEffect(effect=effect("load_friction"), joint=0, shapes=(0.02,))
    assert select_predictive(comparison, [load, there]) == [there]


@pytest.mark.parametrize(
    ("falls", "borne"),
    [
        ([3.0, 2.0, 4.0], True),  # of 100 in each
        ([9.0, -0.1, -0.1], False),  # one part alone
        ([9.0, 0.1, -9.0], False),  # as much lost as gained
        ([0.2, 0.2, 0.2], False),  # next to nothing
    ],
)
def test_finding_must_help_in_most_folds(falls: list[float], borne: bool) -> None:
    """By the squares that it takes away in parts that no fit saw."""
    without = np.full((3, 1), 100.0)
    excess = _excess_share(without - np.array(falls)[:, None], without)
    assert (excess >= 0.0) == borne
    if borne:
        assert excess == pytest.approx(0.03 - MIN_HELD_OUT_SHARE)


@pytest.mark.parametrize("changed", [False, True])
def test_effect_without_action_is_dropped(changed: bool) -> None:
    """Columns that are zero everywhere act in no part, however the squares fall."""
    acted = np.zeros(3, dtype=bool)
    without = np.full((3, 1), 100.0)
    assert _excess_share(0.9 * without, without, acted=acted, changed=changed) == -1.0


@pytest.mark.parametrize(
    ("falls", "change"),
    [
        ([30.0, 20.0, 40.0, 30.0, 20.0, 40.0], True),  # of 100 in each
        ([3.0, 2.0, 4.0, 3.0, 2.0, 4.0], False),  # as little as a model errs from part to part
        ([70.0, 0.1, -0.1, 65.0, 0.1, -0.1], True),  # a stop, which is reached in two parts
        ([99.0, 0.1, 0.1, 0.1, -0.1, 0.1], False),  # one part alone
    ],
)
def test_change_must_exceed_open_residual(falls: list[float], change: bool) -> None:
    without = np.full((6, 1), 100.0)
    excess = _excess_share(without - np.array(falls)[:, None], without, changed=True)
    assert (excess >= 0.0) == change


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


def test_friction_is_refitted_to_moving_samples() -> None:
    """A level that is off comes back to what the runs bear out, and is no surer for it."""
    training = prepare_training(load_recordings(SHIPPED), Settings())
    constants = training.constants
    there = LocatedEffect(effect=effect("coulomb"), joint=1)
    comparison = training.comparison()
    first = estimate_parameters(comparison, [there])
    size = there.sizes(constants)[0]
    off = first.moved(np.array([0.5]))
    assert off.effects[0].amplitudes[0] == pytest.approx(
        first.effects[0].amplitudes[0] + 0.5 * size
    )
    # Its words follow the sign of the amplitude.
    assert "more dry friction" in there.effect.phrase_of(off.effects[0].amplitudes)
    rows = _MovingSamples(training, training.settings, (), off, [effect("coulomb").identity])
    again = _apply_steps(training, off, rows, [effect("coulomb").identity])
    value, sd = again.parameters(0, there.constants(constants))["dFc"]
    known, exact = first.parameters(0, there.constants(constants))["dFc"]
    assert value == pytest.approx(known, rel=0.05)
    assert sd > 0.4 * size > exact


def test_friction_contradicted_by_moving_samples_is_dropped() -> None:
    """What is there stays as it was estimated; of a joint that has none nothing is claimed."""
    training = prepare_training(load_recordings(SHIPPED), Settings())
    comparison = training.comparison()
    places = [LocatedEffect(effect=effect("coulomb"), joint=j) for j in (0, 1)]
    wrong = estimate_parameters(comparison, places).moved(np.array([1.0, 0.0]))
    rows = _MovingSamples(training, training.settings, (), wrong, [effect("coulomb").identity])
    helps = [rows.helps(found, [effect("coulomb").identity], training) for found in wrong.effects]
    assert helps == [False, True]
    there = Selected(places[1], 1.0, 1.0, 1.0, (), 1)
    kept, parameters = refit_friction(training, training.settings, (), comparison, [there])
    assert kept == (there,)
    known = estimate_parameters(comparison, places[1:]).effects
    assert parameters.effects[0].amplitudes == known[0].amplitudes


def test_link_encoder_offset_is_not_refitted() -> None:
    """It changes none of them, and goes by nothing that they say."""
    training = prepare_training(load_recordings(SHIPPED), Settings())
    comparison = training.comparison()
    offset = LocatedEffect(effect=effect("encoder_offset"), joint=0)
    there = LocatedEffect(effect=effect("coulomb"), joint=1)
    found = [Selected(each, 1.0, 1.0, 1.0, (), 1) for each in (offset, there)]
    kept, _ = refit_friction(training, training.settings, (), comparison, found)
    assert [each.located for each in kept] == [offset, there]


def test_collinear_amplitudes_are_insignificant_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two columns that are nearly alike share what one of them alone would be sure of."""
    draw = np.random.default_rng(1)
    count = 800
    first = draw.normal(size=count)
    alike = np.column_stack([first, first + 0.1 * draw.normal(size=count)])
    target = 0.5 * first + draw.normal(size=count)
    monkeypatch.setattr(uncertainty, "number_stretches", lambda _: np.arange(count) // 40)

    def sure(columns: np.ndarray) -> tuple[float, float]:
        gram = columns.T @ columns + np.eye(columns.shape[1])
        amplitudes = np.linalg.solve(gram, columns.T @ target)
        comparison: Any = SimpleNamespace(
            target=target,
            priors=([], np.zeros(0)),
            stack_columns=lambda _: columns,
            fit=lambda _: SimpleNamespace(amplitudes=lambda: amplitudes),
        )
        name = ("coulomb", "asym_friction")[columns.shape[1] - 1]
        located = LocatedEffect(effect=effect(name), joint=0)
        assert len(located.effect.amplitudes) == columns.shape[1]
        together, single = uncertainty.jackknife_significance(comparison, [located])
        return float(together[0]), float(single[0])

    alone, both = sure(alike[:, :1]), sure(alike)
    assert alone[0] == pytest.approx(alone[1])
    assert alone[1] > 5.0
    assert both[0] > 5.0
    assert both[1] < 0.5 * both[0]
