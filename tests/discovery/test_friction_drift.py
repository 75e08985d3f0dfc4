"""Friction that differs from run to run: its spread, and what a further run may have."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosed_folders import written
from simulated_sets import diagnosed, said, short_case, simulated

from stiffopt.discovery.catalogue.friction_drift import FRICTION_DRIFT, friction_drift
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.extended.model import load_extended
from stiffopt.discovery.extended.store import extended_text
from stiffopt.discovery.user_effects import find_faults, sample_signals
from stiffopt.report.diagnosis.mismatch import carried_over_sentences

DRIFT = short_case(("friction_drift", 1, 1.0), seed=101)


def of_run(name, entry, levels, share=0.0):
    signals = sample_signals().of_joint(4)
    return entry.term(replace(signals, run=name), levels, [share]).drive_torque


def test_a_run_is_off_from_the_mean_of_all_and_a_further_one_is_not():
    entry = friction_drift(("a", "b"))
    off = of_run("a", entry, [0.1, -0.2])
    assert np.any(off != 0.0)
    np.testing.assert_allclose(of_run("b", entry, [0.1, -0.2]), -off)
    assert of_run("c", entry, [0.1, -0.2]) == 0.0


def test_what_all_runs_share_is_friction_of_other_effects():
    entry = friction_drift(("a", "b"))
    np.testing.assert_allclose(of_run("a", entry, [0.3, 0.3]), 0.0, atol=1e-12)


def test_runs_of_another_set_are_others_whatever_their_names():
    entry = FRICTION_DRIFT.of_runs(("a", "b"), seen=False)
    assert of_run("a", entry, [0.1, -0.2]) == 0.0


def test_a_curve_over_time_is_of_its_own_run():
    within = friction_drift(("a", "b")).likelier_than
    levels = np.zeros(len(within.amplitudes))
    levels[: len(levels) // 2] = 0.1
    signals = sample_signals().of_joint(4)
    ran = within.term(replace(signals, run="a"), levels, ()).drive_torque
    # A level curve is what drift is, dry.
    np.testing.assert_allclose(ran, of_run("a", friction_drift(("a", "b")), [0.1, -0.1]))
    assert not np.any(within.term(replace(signals, run="b"), levels, ()).drive_torque)
    assert within.term(replace(signals, run="c"), levels, ()).drive_torque == 0.0


def test_spread_is_that_of_the_runs():
    entry = friction_drift(("a", "b", "c"))
    constants = sample_signals().constants.joints[4]
    values = entry.parameters([0.2, 0.0, -0.2], [0.0], constants)
    assert values["dFc_spread"] == pytest.approx(0.2 * constants.coulomb)
    assert values["dFv_spread"] == 0.0
    few = entry.drawn([0.2, 0.0, -0.2], [0.0], constants)
    assert few["dFc_spread"] == pytest.approx(0.1 * constants.coulomb)
    assert list(find_faults(FRICTION_DRIFT)) == []


@pytest.mark.slow
def test_a_friction_law_of_another_form_is_no_drift():
    """Runs at other speeds differ by it as well."""
    spec = replace(DRIFT, effects=(("viscous_power", 1, 1.0),))
    found = diagnosed(spec)
    assert "friction_drift" not in [f.effect.name for f in found.findings], said(found)


@pytest.mark.slow
def test_friction_that_changes_within_runs_is_no_drift():
    """A hose that another joint pinches: runs differ by it, since their motions do."""
    spec = replace(DRIFT, robot="big6", effects=(("neighbour_friction", 2, 0.1),), seed=112)
    found = diagnosed(spec)
    assert "friction_drift" not in [f.effect.name for f in found.findings], said(found)
    assert found.verdict == "outside_catalogue"


@pytest.mark.slow
def test_a_small_drift_is_likelier_than_a_curve_over_time():
    spec = replace(DRIFT, robot="big6", effects=(("friction_drift", 2, 0.1),), seed=104)
    found = diagnosed(spec)
    assert [(f.effect.name, f.joint) for f in found.findings] == [("friction_drift", 2)], said(
        found
    )


@pytest.mark.slow
def test_drift_is_named_as_one_effect_with_its_spread(tmp_path):
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
    assert "a further run is predicted with the mean" in carried_over_sentences(found)[0]
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
def test_friction_that_falls_with_warmth_is_no_drift():
    spec = replace(DRIFT, effects=(("thermal_friction", 1, 1.0),), seed=56)
    found = diagnosed(spec)
    assert [(f.effect.name, f.joint) for f in found.findings] == [("thermal_friction", 1)], said(
        found
    )
