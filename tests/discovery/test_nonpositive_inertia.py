"""Nonpositive inertia during a fit: no linearisation about it, no initial vibration."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from simulated_sets import COULOMB, simulated

from benchmarks.simulator import write_case
from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.design_matrix import DesignMatrix
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


@pytest.fixture(scope="module")
def columns(tmp_path_factory):
    """Of a short run whose links swing."""
    small = replace(COULOMB, effects=(), train=1, extrapolate=0, seconds=2.0)
    folder = write_case(simulated(small), tmp_path_factory.mktemp("vibrating") / "set")
    return prepare_training(load_recordings(folder), Settings()).comparison().columns


def with_payload(mass):
    payload = next(each for each in CATALOGUE if each.name == "payload")
    amplitudes = (mass, *(0.0 for _ in payload.amplitudes[1:]))
    located = LocatedEffect(effect=payload, joint=None)
    return Extension(effects=(EstimatedEffect(located=located, amplitudes=amplitudes),))


def test_design_matrix_is_not_linearised_about_nonpositive_inertia(columns):
    possible = columns.linearised_at(with_payload(1.0))
    assert possible is not columns
    assert possible.initial_state_columns.shape[1] > 0
    # The arm would have a mass below nothing.
    assert columns.linearised_at(with_payload(-5.0)) is columns
    assert columns.linearised_at(with_payload(1.0)) is possible


@pytest.mark.filterwarnings("ignore:.*encountered in:RuntimeWarning")
def test_initial_states_exclude_nonpositive_inertia(columns):
    own = (columns.robot, columns.nominal_runs, columns.noise, columns.tolerance, columns.start)
    run = DesignMatrix(*own, with_payload(-5.0)).runs[0]
    frequencies, _ = run.vibration.response.modes(0)
    assert frequencies[0] == 0.0
    assert 0.0 < frequencies[1] < 100.0
    torque, deflection = run.vibration.free_vibration(
        run.vibration.initial_states(run.signals.windup, 100.0)
    )
    assert torque.shape[2] == deflection.shape[2] == 0


def test_nonpositive_inertia_is_detected_at_any_sample(columns):
    swing = columns.nominal_runs[0].vibration
    assert swing.has_positive_inertia
    mobility = swing.response.mobility.copy()
    mobility[-7] = np.diag([1.0, -1.0]) @ mobility[-7]
    response = copy(swing.response)
    response.mobility = mobility
    assert not replace(swing, response=response).has_positive_inertia
