"""Findings that held-out runs refute."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from shipped_set import LACKS, SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.conclusions import refutable_channels
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.discovery.judging.refutation import _best_within, _likelihood_of_gain
from stiffopt.report.diagnosis.mismatch import refutation_sentences


def _with_held_out_friction(to: Path, factor: float) -> Path:
    """Copy the shipped set; held-out runs have a multiple of the friction that its model lacks."""
    copy = Path(shutil.copytree(SHIPPED, to))
    (lack,) = LACKS.effects
    with np.load(copy / "test_1.npz") as stored:
        signals = dict(stored)
    signals["tau2"] = signals["tau2"] + (factor - 1.0) * lack.amplitudes[0] * np.sign(
        signals["qd2"]
    )
    np.savez(copy / "test_1.npz", **signals)
    return copy


def _friction_of(diagnosis: Diagnosis) -> float:
    (found,) = [f for f in diagnosis.findings if f.effect.name == "coulomb" and f.joint == 2]
    assert found.held_out_ratio is not None
    return found.probability


@pytest.mark.parametrize(("factor", "refutes"), [(1.0, False), (-1.0, True)])
def test_held_out_runs_refute_friction_that_they_have_the_other_way(
    tmp_path: Path, factor: float, refutes: bool
) -> None:
    """The same training runs give the same finding; with its opposite held out it is not named."""
    answer = diagnose(_with_held_out_friction(tmp_path / "set", factor), experiment=False)
    (ratio,) = [f.held_out_ratio for f in answer.findings]
    assert ratio is not None
    assert (ratio > 1.0) == refutes
    assert (_friction_of(answer) < 0.5) == refutes
    assert (answer.verdict == "named") != refutes
    assert bool(refutation_sentences(answer)) == refutes


def test_refuting_runs_change_no_value_and_no_model(tmp_path: Path) -> None:
    """Findings, their values and the extended model are those of the training runs."""
    one, other = (
        diagnose(_with_held_out_friction(tmp_path / f"set{factor:g}", factor), experiment=False)
        for factor in (1.0, -1.0)
    )
    told = [
        [(f.effect.name, f.joint, f.estimated.amplitudes, f.parameters) for f in each.findings]
        for each in (one, other)
    ]
    assert told[0] == told[1]
    assert one.extension.calibration == other.extension.calibration
    amplitudes = [[e.amplitudes for e in each.extension.effects] for each in (one, other)]
    assert amplitudes[0] == amplitudes[1]


def test_likelihood_of_a_loss_falls_with_its_agreement_between_stretches() -> None:
    assert _likelihood_of_gain(np.array([3.0, -1.0, 2.0])) == 1.0
    agreed, single = np.array([-3.0, -2.0, -4.0] * 3), np.array([-30.0] + [0.0] * 8)
    assert _likelihood_of_gain(agreed) < 1e-5
    assert 0.3 < _likelihood_of_gain(single) < 0.8
    # The scale says nothing: another channel has another unit.
    assert _likelihood_of_gain(1e6 * agreed) == pytest.approx(_likelihood_of_gain(agreed))


def test_findings_of_single_runs_are_not_tested() -> None:
    """The gain of a held-out run is another one: its mean over training runs may predict worse."""
    located = [
        LocatedEffect(effect=effect("gain_drift"), joint=1),
        LocatedEffect(effect=effect("coulomb"), joint=1),
        LocatedEffect(effect=effect("coulomb"), joint=0, calibrated=True),
    ]
    findings: list[Any] = [SimpleNamespace(located=e, channel="torque_2") for e in located]
    assert list(refutable_channels(findings)) == [located[1].key]


def test_values_that_predict_best_are_sought_in_their_likely_region() -> None:
    """Within 95 % of the posterior: of one value two deviations, of many more."""
    draw = np.random.default_rng(5)
    columns = draw.normal(size=(50, 2))
    for far in (0.5, 40.0):
        residual = columns @ np.array([far, -far])
        rows = np.column_stack([residual, columns])
        found = _best_within(rows.T @ rows)
        if far < 1.0:
            np.testing.assert_allclose(found, [far, -far], rtol=1e-6)
        else:
            assert np.linalg.norm(found) == pytest.approx(np.sqrt(5.991), rel=1e-3)
            angles = np.linspace(0.0, 2.0 * np.pi, 721)
            ring = np.sqrt(5.991) * np.array([np.cos(angles), np.sin(angles)])
            best = np.min(np.sum((residual[:, None] - columns @ ring) ** 2, axis=0))
            assert np.sum((residual - columns @ found) ** 2) <= best * (1.0 + 1e-4)
    assert np.all(_best_within(np.diag([1.0, 0.0])) == 0.0)
