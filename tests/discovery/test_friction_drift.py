"""Friction that differs from run to run: spread, and prediction of a further run."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosed_folders import written
from simulated_sets import diagnosed, said, short_case, simulated

from stiffopt.discovery.catalogue.drift import (
    FRICTION_DRIFT,
    FRICTION_IN_RUNS,
    deviations_of_runs,
    friction_drift,
    friction_in_runs,
    of_other_runs,
)
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.extended.model import load_extended
from stiffopt.discovery.extended.store import extended_text
from stiffopt.discovery.user_effects import find_faults, sample_signals
from stiffopt.report.diagnosis.mismatch import transfer_sentences

DRIFT = short_case(("friction_drift", 1, 1.0), seed=101)


def of_run(name, entry, levels, share=0.0):
    signals = sample_signals().of_joint(4)
    return entry.term(replace(signals, run=name), levels, [share]).drive_torque


def test_drift_term_deviates_in_recorded_runs_only():
    entry = friction_drift(("a", "b"))
    off = of_run("a", entry, [0.1, -0.2])
    assert np.any(off != 0.0)
    np.testing.assert_allclose(of_run("b", entry, [0.1, -0.2]), -off)
    assert of_run("c", entry, [0.1, -0.2]) == 0.0


def test_drift_term_has_zero_mean_over_runs():
    entry = friction_drift(("a", "b"))
    np.testing.assert_allclose(of_run("a", entry, [0.3, 0.3]), 0.0, atol=1e-12)


def test_drift_of_unrecorded_runs_ignores_names():
    entry = of_other_runs(FRICTION_DRIFT, ("of a", "of b"))
    assert of_run("a", entry, [0.1, -0.2]) == 0.0


def test_friction_of_some_runs_acts_in_these_and_never_in_the_last():
    entry, signals = friction_in_runs(("a", "b", "c", "d")), sample_signals().of_joint(4)
    for run, acts in zip("abcde", (False, True, True, False, False), strict=True):
        term = entry.term(replace(signals, run=run), [0.5, 0.1], [2.0, 3.0])
        assert np.any(term.drive_torque) == acts
    tried = [(a, b) for a in range(1, 5) for b in range(1, 5)]
    kept = [each for each in tried if entry.possible(each, signals.constants)]
    assert kept == [(1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)]
    assert "from b to c" in entry.remedy([0.5, 0.1], [2.0, 3.0], signals.constants)
    other = of_other_runs(FRICTION_IN_RUNS, ("dFc", "dFv"))
    assert other.term(replace(signals, run="a"), [0.5, 0.1], [1.0, 1.0]).drive_torque == 0.0


def test_friction_within_runs_acts_in_its_own_run():
    within = friction_drift(("a", "b")).likelier_than
    levels = np.zeros(len(within.amplitudes))
    levels[: len(levels) // 2] = 0.1
    signals = sample_signals().of_joint(4)
    ran = within.term(replace(signals, run="a"), levels, ()).drive_torque
    # A level curve is what drift is, dry.
    np.testing.assert_allclose(ran, of_run("a", friction_drift(("a", "b")), [0.1, -0.1]))
    assert not np.any(within.term(replace(signals, run="b"), levels, ()).drive_torque)
    assert within.term(replace(signals, run="c"), levels, ()).drive_torque == 0.0


def test_drift_reports_spread_of_amplitudes():
    entry = friction_drift(("a", "b", "c"))
    constants = sample_signals().constants.joints[4]
    values = entry.parameters([0.2, 0.0, -0.2], [0.0], constants)
    assert values["dFc_spread"] == pytest.approx(0.2 * constants.coulomb)
    assert values["dFv_spread"] == 0.0
    few = entry.drawn([0.2, 0.0, -0.2], [0.0], constants)
    assert few["dFc_spread"] == pytest.approx(0.1 * constants.coulomb)
    assert list(find_faults(FRICTION_DRIFT)) == []


def test_drift_tells_which_run_deviates():
    entry = friction_drift(("a", "b", "c"))
    runs, off = zip(*deviations_of_runs(entry, (0.1, 0.4, 0.1)), strict=True)
    assert runs == ("a", "b", "c")
    np.testing.assert_allclose(off, [-1.0 / 3**0.5, 2.0 / 3**0.5, -1.0 / 3**0.5])


@pytest.mark.slow
def test_drift_is_not_found_for_other_friction_law():
    """Runs at other speeds differ by it as well."""
    spec = replace(DRIFT, effects=(("viscous_power", 1, 1.0),))
    found = diagnosed(spec)
    assert "friction_drift" not in [f.effect.name for f in found.findings], said(found)


@pytest.mark.slow
def test_drift_is_not_found_for_changes_within_runs():
    """A hose that another joint pinches: runs differ by it, since their motions do."""
    spec = replace(DRIFT, robot="big6", effects=(("neighbour_friction", 2, 0.2),), seed=112)
    found = diagnosed(spec)
    assert "friction_drift" not in [f.effect.name for f in found.findings], said(found)
    assert found.verdict == "law_found"
    (law,) = found.laws
    assert {factor.source.words for factor in law.law.factors} == {
        "direction of motion of joint 2", "position of joint 3",
    }, law.law  # fmt: skip


@pytest.mark.slow
def test_small_drift_is_likelier_than_curve_over_time():
    spec = replace(DRIFT, robot="big6", effects=(("friction_drift", 2, 0.1),), seed=104)
    found = diagnosed(spec)
    assert [(f.effect.name, f.joint) for f in found.findings] == [("friction_drift", 2)], said(
        found
    )


@pytest.mark.slow
def test_drift_is_found_with_its_spread(tmp_path):
    found = diagnosed(DRIFT)
    assert [(f.effect.name, f.joint) for f in found.findings] == [("friction_drift", 1)], said(
        found
    )
    case = simulated(DRIFT)
    (line,) = case.truth["effects"]
    levels = np.array(line["law"]["of_runs"][:4])
    values = {p.name: p for p in found.findings[0].parameters}
    assert values["dFc_spread"].value == pytest.approx(levels.std(ddof=1), rel=0.1)
    # As few runs tell of all.
    assert values["dFc_spread"].sd > 0.9 * levels.std(ddof=1) / np.sqrt(6.0)
    (drift,) = found.drift
    (kind,) = [each.kind for each in found.not_carried_over]
    assert kind == "friction drift"
    assert drift.rms > 0.5
    assert [run for run, _ in drift.by_run] == [run.name for run in found.training.recorded]
    assert "predictions use the mean" in transfer_sentences(found)[0]
    path = tmp_path / "extended.toml"
    path.write_text(extended_text(found), encoding="utf-8")
    (again,) = load_extended(path).extension.effects
    assert again.amplitudes == found.findings[0].estimated.amplitudes
    later = diagnose(written(DRIFT), model=path, experiment=False)
    assert [(each.joint, each.dry, each.viscous) for each in later.drift] == [
        (each.joint, pytest.approx(each.dry, rel=2e-3), pytest.approx(each.viscous, rel=2e-3))
        for each in found.drift
    ]


@pytest.mark.slow
def test_drift_is_not_found_for_thermal_friction():
    spec = replace(DRIFT, effects=(("thermal_friction", 1, 1.0),), seed=56)
    found = diagnosed(spec)
    assert [(f.effect.name, f.joint) for f in found.findings] == [("thermal_friction", 1)], said(
        found
    )
