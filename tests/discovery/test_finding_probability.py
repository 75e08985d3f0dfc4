"""Probability of a finding on the shipped two-link set, which lacks dry friction of joint 2."""

from __future__ import annotations

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery import conclusions
from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.conclusions import build_findings
from stiffopt.discovery.search.left_out_gain import LeftOutGain
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import Estimate, estimate_parameters
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.recording.recording_set import load_recordings


@pytest.fixture(scope="module")
def training() -> Training:
    return prepare_training(load_recordings(SHIPPED), Settings())


@pytest.mark.parametrize(
    ("calibrated", "left_open", "support", "again", "probability"),
    [
        (False, 0.0, 1.0, 1.0, 1.0),
        (False, 10.0, 1.0, 1.0, 0.5),  # as much open as explained
        (True, 10.0, 1.0, 1.0, 1.0),  # a value that every joint has
        (False, 0.0, 0.7, 1.0, 0.7),
        (False, 0.0, 1.0, 0.5, 0.5),
    ],
)
def test_probability_is_the_product_of_its_shares(
    training: Training,
    monkeypatch: pytest.MonkeyPatch,
    calibrated: bool,
    left_open: float,
    support: float,
    again: float,
    probability: float,
) -> None:
    gain = LeftOutGain(
        removed=10.0, left_open=left_open, share=0.5, explained=0.5, channel=1, support=support
    )
    monkeypatch.setattr(conclusions, "left_out_gains", lambda *_: (gain,))
    located = LocatedEffect(effect=effect("coulomb"), joint=1, calibrated=calibrated)
    comparison = training.comparison()
    known: Estimate = estimate_parameters(comparison, [located])
    there = Selected(located, 1.0, 1.0, 1.0, (), 1)
    (found,) = build_findings(comparison, [there], known, training, np.array([again]))
    assert found.probability == pytest.approx(probability, abs=0.01)


def test_gains_of_cut_runs_count_alike(training: Training, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is gained once the first 5 % of the runs are left out."""

    def gains(_: object, __: object, begin: float, ___: int) -> tuple[LeftOutGain]:
        left_open = 0.0 if begin < 0.05 else 1e6
        gain = LeftOutGain(
            removed=10.0, left_open=left_open, share=0.5, explained=0.5, channel=1, support=1.0
        )
        return (gain,)

    monkeypatch.setattr(conclusions, "left_out_gains", gains)
    located = LocatedEffect(effect=effect("coulomb"), joint=1)
    comparison = training.comparison()
    known = estimate_parameters(comparison, [located])
    there = Selected(located, 1.0, 1.0, 1.0, (), 1)
    (found,) = build_findings(comparison, [there], known, training, np.ones(1))
    assert found.probability == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("calibrated", [False, True])
def test_friction_is_claimed_by_its_value_as_any_effect(
    training: Training, monkeypatch: pytest.MonkeyPatch, calibrated: bool
) -> None:
    """Two deviations from zero: no claim, although every joint has some friction."""
    gain = LeftOutGain(
        removed=10.0, left_open=0.0, share=0.5, explained=0.5, channel=1, support=1.0
    )
    monkeypatch.setattr(conclusions, "left_out_gains", lambda *_: (gain,))
    monkeypatch.setattr(Estimate, "p_value", lambda *_: 0.05)
    located = LocatedEffect(effect=effect("coulomb"), joint=1, calibrated=calibrated)
    comparison = training.comparison()
    there = Selected(located, 1.0, 1.0, 1.0, (), 1)
    known = estimate_parameters(comparison, [located])
    (found,) = build_findings(comparison, [there], known, training, np.ones(1))
    assert found.probability == pytest.approx(0.7, abs=0.02)
