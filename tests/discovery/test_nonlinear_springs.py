"""Link motion with nonlinear springs and with springs that lag their load."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_sets import COULOMB, simulated

from benchmarks.simulator import CaseSpec, write_case
from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison import extended_run
from stiffopt.discovery.comparison.extension_change import relative_compliance
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect
from stiffopt.discovery.laws.law import Factor, Law, law_effect
from stiffopt.discovery.laws.sources import LawSource
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


def test_simulate_links_accepts_oscillation_below_tolerance(tmp_path):
    """Joint 6 at a bend, by 0.2 urad: no motion was found, and links counted as in balance."""
    spec = CaseSpec(
        robot="arm7",
        seed=107,
        tolerance=0.0,
        train=1,
        test=1,
        extrapolate=0,
        seconds=5.0,
        rate=250.0,
        substeps=8,
        smoothing=0.2,
        payload=5.891215516401546,
    )
    case = simulated(spec)
    training = prepare_training(load_recordings(write_case(case, tmp_path / "set")), Settings())
    (run,) = training.runs
    assert run.vibration is not None
    true = case.trace.link[0, :: spec.substeps][: len(run.time)]
    off = (run.signals.link_position - true) / training.noise.channels.deflection
    assert np.sqrt(np.mean(off**2)) < 1.5


@pytest.fixture(scope="module")
def creeping(tmp_path_factory):
    """A run with nothing missing, its robot and a belt as soft as the joint that creeps."""
    case = simulated(replace(COULOMB, effects=()))
    training = prepare_training(
        load_recordings(write_case(case, tmp_path_factory.mktemp("creep"))), Settings()
    )
    run = training.runs[0]
    compliance = float(training.robot.compliance(0.0 * run.torque[:1])[0, 1])
    belt = EstimatedEffect(
        located=LocatedEffect(effect=effect("belt_creep"), joint=1, shapes=(0.15,)),
        amplitudes=(0.1 * compliance, 0.4 * compliance),
    )
    return run, training.robot, Extension(effects=(belt,))


def test_relative_compliance_of_belt_excludes_creep(creeping):
    run, robot, extension = creeping
    softer = relative_compliance(run, extension)
    quick = 0.5 * (1.0 - np.exp(-run.signals.dt / 0.15))
    nominal = robot.compliance(run.signals.spring_torque) / robot.compliance(0.0 * run.torque)
    np.testing.assert_allclose(softer[:, 0], 1.0)
    added = (softer[1:, 1] - 1.0) * nominal[1:, 1]
    off = np.abs(added / (0.1 + 0.4 * quick) - 1.0)
    # A step over a corner of the reducer has the slope of neither side.
    assert np.mean(off < 0.05) > 0.98
    assert np.max(off) < 0.5


def test_simulate_links_with_creeping_belt_converges_in_few_rounds(creeping, monkeypatch):
    """With the slope of a belt that has settled it took hundreds, and some found no motion."""
    run, _, extension = creeping
    rounds, whole_change = [], extended_run.extension_change

    def counted(*given):
        rounds.append(1)
        return whole_change(*given)

    monkeypatch.setattr(extended_run, "extension_change", counted)
    found = extended_run.simulate_links(run, extension)
    (added,) = (e.located.contribution(found, e.amplitudes) for e in extension.effects)
    assert np.max(np.abs(added.deflection)) > 1e-4
    np.testing.assert_allclose(found.added_deflection, added.deflection, atol=1e-6)
    assert len(rounds) < 60


@pytest.mark.parametrize("kind", ["speed", "load"])
def test_a_law_of_the_load_makes_the_spring_softer_and_others_do_not(creeping, kind):
    """Links vibrated on the nominal spring: predictions were off by twice the law itself."""
    run, robot, _ = creeping
    compliance = float(robot.compliance(0.0 * run.torque[:1])[0, 1])
    law = Law(1, "deflection", (Factor(LawSource(kind, 1), "linear"),))
    located = LocatedEffect(effect=law_effect(law, [1.0]), joint=1)
    softer = EstimatedEffect(located=located, amplitudes=(0.3 * compliance,))
    found = relative_compliance(run, Extension(effects=(softer,)))
    nominal = robot.compliance(run.signals.spring_torque)[:, 1] / compliance
    expected = 1.3 if kind == "load" else 1.0
    np.testing.assert_allclose(found[:, 0], 1.0)
    assert np.median((found[:, 1] - 1.0) * nominal + 1.0) == pytest.approx(expected, abs=1e-3)
