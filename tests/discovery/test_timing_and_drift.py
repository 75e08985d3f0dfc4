"""Causes in time: clocks, commanded torque, drifting torque constants, values out of tolerance."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from simulated_sets import diagnosis_of, said, short_case, simulated
from small_arms import ROOT

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.nuisance import OutsideValue
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.search.nominal_values import values_outside_tolerance
from stiffopt.discovery.user_effects import sample_signals
from stiffopt.errors import InputFileError
from stiffopt.report.diagnosis.values_to_enter import (
    _pinned_change,
    farthest_value,
    value_sentences,
)

CASES = ROOT.parent / "shared" / "cases" / "diagnosis"
ROBOT = sample_signals()


@cache
def case(name: str) -> Diagnosis:
    if not (CASES / name).is_dir():
        pytest.skip("../shared/cases is absent")
    return diagnose(CASES / name, experiment=False)


def values(diagnosis: Diagnosis) -> dict[tuple[str, int | None], dict[str, float]]:
    return {
        (f.effect.name, f.joint): {p.name: p.value for p in f.parameters}
        for f in diagnosis.findings
    }


def test_commanded_torque_is_named_with_its_lead() -> None:
    found = case("pd_torque_cmd")
    assert list(values(found)) == [("time_delay", None)], said(found)
    (finding,) = found.findings
    assert finding.parameters[0].value == pytest.approx(-0.012, abs=1e-3)
    told = " ".join(value_sentences(found))
    assert re.search(r"enter torque_delay = -0\.01[12]\d* in", told)
    assert re.match(r"Torque recorded 1[12]\.\d+ ± [\d.]+ ms ahead of the motion", told)
    assert "commanded torque" in finding.effect.phrase_of(finding.estimated.amplitudes)


def test_falling_torque_constant_is_named_with_its_trend() -> None:
    found = case("slow_drift_kt")
    assert list(values(found)) == [("common_gain_drift", None)], said(found)
    assert values(found)["common_gain_drift", None]["per_run"] == pytest.approx(-0.03, abs=2e-3)


@pytest.mark.parametrize(("name", "share"), [("mfac12", 0.2), ("maint_up13", 0.3)])
def test_friction_outside_its_tolerance_is_named_with_its_value(name: str, share: float) -> None:
    found = case(name)
    own = values(found)
    assert set(own) == {("coulomb", 2), ("viscous", 2)}, said(found)
    assert own["coulomb", 2]["dFc"] == pytest.approx(share * 14.0, rel=0.1)
    assert own["viscous", 2]["dFv"] == pytest.approx(share * 14.0, rel=0.1)
    assert all(f.probability > 0.5 for f in found.findings), said(found)
    told = value_sentences(found)
    assert len(told) == 2
    corrected = 14.0 * (1.0 + share)
    (entered,) = re.findall(r"Enter coulomb = \[12\.0, ([0-9.]+), 9\.0", told[0])
    assert float(entered) == pytest.approx(corrected, rel=0.02)


def test_recordings_without_torque_are_refused_with_what_to_record() -> None:
    if not (CASES / "notorque").is_dir():
        pytest.skip("../shared/cases is absent")
    with pytest.raises(InputFileError, match=r"signals.torque: no joint has a torque or a command"):
        diagnose(CASES / "notorque", experiment=False)


def test_nothing_is_outside_on_another_arm() -> None:
    found = diagnosis_of(simulated(short_case(seed=211, robot="small3")), lambda folder: None)
    assert found.verdict == "nothing_missing", said(found)


@pytest.mark.parametrize("joint", [1, 3])
def test_friction_just_outside_its_tolerance_is_named_on_another_arm(joint: int) -> None:
    """Four times the simulator's tolerance of 1.5 %, where no single value passes a search."""
    spec = short_case(("coulomb", joint, 0.2), seed=212, robot="small3")
    (line,) = simulated(spec).truth["effects"]
    found = diagnosis_of(simulated(spec), lambda folder: None)
    own = values(found)
    assert set(own) == {("coulomb", joint)}, said(found)
    # The true robot is off by its tolerance as well.
    built = simulated(spec).truth["true_tolerances"]["fc"][joint - 1] - 1.0
    change = line["params"]["dFc"] + built * simulated(spec).robot.coulomb[joint - 1]
    assert own["coulomb", joint]["dFc"] == pytest.approx(change, rel=0.1)


def test_torque_written_ahead_is_a_lead_on_another_arm() -> None:
    def advance(folder: Path) -> None:
        for file in folder.glob("*.npz"):
            columns = dict(np.load(file))
            for name in [key for key in columns if key.startswith("tau")]:
                columns[name] = np.interp(columns["t"] + 0.006, columns["t"], columns[name])
            np.savez_compressed(file, **columns)

    found = diagnosis_of(simulated(short_case(seed=213, robot="small3")), advance)
    assert list(values(found)) == [("time_delay", None)], said(found)
    assert values(found)["time_delay", None]["d"] == pytest.approx(-0.006, abs=5e-4)


@pytest.mark.parametrize("name", ["time_delay", "run_clock", "clock_drift"])
@pytest.mark.parametrize("about", [2e-3, -2e-3])
def test_shift_agrees_with_the_one_it_is_linear_about(name: str, about: float) -> None:
    """A long shift with a small amplitude is a filter of the torque, not a delay."""
    located = LocatedEffect(effect=effect(name), shapes=(about,))
    low, high = located.bounds(ROBOT.constants)[0] * located.sizes(ROBOT.constants)[0]
    assert low < about < high
    assert (low > 0.0) == (high > 0.0) == (about > 0.0)
    assert max(abs(low), abs(high)) < 10.0 * min(abs(low), abs(high))


@pytest.mark.parametrize(
    ("name", "least"), [("time_delay", 7e-5), ("run_clock", 4e-4), ("clock_drift", 7e-5)]
)
def test_every_shift_agrees_with_one_that_a_search_starts_from(name: str, least: float) -> None:
    """A drift of clocks of 1e-4 was at 20 deviations, and ten times below the least start."""
    entry = effect(name)
    starts = [LocatedEffect(effect=entry, shapes=(s,)) for s in entry.shapes[0].starts]
    size = starts[0].sizes(ROBOT.constants)[0]
    ranges = np.array([each.bounds(ROBOT.constants)[0] * size for each in starts])
    for shift in np.geomspace(least, 2.0 * abs(entry.shapes[0].starts[0]), 100):
        for signed in (shift, -shift):
            assert np.any((ranges[:, 0] <= signed) & (signed <= ranges[:, 1])), signed


@pytest.mark.parametrize("rate", [2e-3, -5e-3])
def test_clock_drift_reads_torque_at_drifted_instants(rate: float) -> None:
    time = 0.004 * np.arange(1500)
    wave = np.sin(5.0 * time[:, None] + np.arange(6))
    signals = replace(ROBOT, drive_torque=wave, drive_torque_rate=0.0 * wave, time=time, dt=0.004)
    term = effect("clock_drift").term(signals, [rate, 0.0], [rate])
    expected = np.sin(5.0 * time[:, None] * (1.0 - rate) + np.arange(6)) - wave
    np.testing.assert_allclose(term.drive_torque[5:-12], expected[5:-12], atol=1e-4)


def test_value_beside_many_others_is_told_as_pinned() -> None:
    """Too many values outside their tolerances are another cause, and none is claimed."""
    found = case("mfac12")
    bare = replace(found.search, selected=())
    told = value_sentences(replace(found, search=bare, findings=()))
    assert len(told) == 2
    assert all("Nominal value pinned at its tolerance: the" in each for each in told)
    assert any("friction of joint 2 would have to change by +19" in each for each in told)


@pytest.mark.parametrize(
    ("kind", "change", "told"),
    [
        ("coulomb", 1.9, "would have to change by +190 ± 10 %"),
        ("coulomb", -2.3, "would have to be below zero"),
        ("com", -2.3, "would have to change by -2.3 ± 0.1 m"),
    ],
)
def test_a_value_that_would_be_negative_is_told_so(kind: str, change: float, told: str) -> None:
    assert told in _pinned_change(OutsideValue(ValueName(kind, 1, "z"), change, 0.1, 0.3))


def test_friction_that_a_simulation_fits_is_not_pinned_by_filtered_torques(monkeypatch) -> None:
    outside = tuple(OutsideValue(ValueName(k, 1), 2.0, 0.1, 0.3) for k in ("coulomb", "mass"))
    where = "stiffopt.report.diagnosis.values_to_enter.values_outside_tolerance"
    monkeypatch.setattr(where, lambda *_: outside)
    search = SimpleNamespace(comparison=None, effects=())
    recorded, simulated = (
        farthest_value(SimpleNamespace(closed_loop=loop, search=search)) for loop in (None, {})
    )
    assert "dry friction" in recorded
    assert "mass" in simulated


def test_drift_of_runs_vanishes_in_other_runs_and_on_average() -> None:
    for name in ("gain_drift", "common_gain_drift"):
        entry = effect(name).of_runs(("a", "b", "c"))
        signals = ROBOT if name == "common_gain_drift" else ROBOT.of_joint(4)
        parts = [
            np.asarray(entry.term(replace(signals, run=run), [0.03, 0.0, -0.06], []).drive_torque)
            for run in ("a", "b", "c")
        ]
        np.testing.assert_allclose(parts[0], 0.04 * signals.drive_torque, rtol=1e-12)
        np.testing.assert_allclose(sum(parts), 0.0, atol=1e-12)
        assert not np.any(entry.term(replace(signals, run="d"), [0.03, 0.0, 1.0], []).drive_torque)


@pytest.mark.parametrize("name", ["friction_warmup", "gain_warmup"])
def test_warmup_starts_at_zero_and_ends_at_its_amplitude(name: str) -> None:
    signals = ROBOT.of_joint(4)
    full = [1.0] + [0.0] * (len(effect(name).amplitudes) - 1)
    term = np.asarray(effect(name).term(signals, full, [3.0]).drive_torque)
    end = signals.motor_direction if name == "friction_warmup" else signals.drive_torque
    assert term[0] == pytest.approx(0.0)
    assert term[-1] == pytest.approx(end[-1])


def test_only_far_and_determined_values_are_outside() -> None:
    names = list(map(ValueName.read, ["coulomb 1", "coulomb 2", "mass 2", "T1 3", "com 2 x"]))
    tolerances = np.array([0.05, 0.05, 0.03, 0.08, 0.003])
    changes = np.array([0.19, 0.16, 0.2, 0.4, -0.012])
    deviations = np.array([0.01, 0.01, 0.02, 0.01, 1e-4])
    posterior = SimpleNamespace(mean=changes, covariance=np.diag(deviations**2))
    comparison: Any = SimpleNamespace(
        priors=(names, tolerances), fit=lambda *_, **__: SimpleNamespace(posterior=posterior)
    )
    found = values_outside_tolerance(comparison, ())
    assert [str(each.name) for each in found] == ["com 2 x", "coulomb 1"]
    assert (found[1].name.kind, found[1].name.place, found[1].of_body) == ("coulomb", 0, False)
    assert found[0].of_body
