"""Candidates judged: what a candidate is about, and how large it may be."""

import numpy as np
import pytest
from simulated_sets import COULOMB, simulated

from benchmarks.simulator import write_case
from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.located_effect import effect_places
from stiffopt.discovery.identifiable import remove_bounds
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


@pytest.fixture(scope="module")
def training(tmp_path_factory):
    path = write_case(simulated(COULOMB), tmp_path_factory.mktemp("candidates") / "set")
    return prepare_training(load_recordings(path), Settings())


def test_channel_of_a_joint_effect_is_of_its_joint(training):
    # Nominal values of other joints that no longer stand in for it are none of its doing.
    comparison, n = training.comparison(), training.robot.n
    scorer = Scorer(comparison)
    tried = 0
    for effect in CATALOGUE:
        if effect.scope != "joint" or effect.couples_joints:
            continue
        for located in effect_places(
            effect, comparison.constants, [run.name for run in comparison.runs]
        ):
            found = scorer.score(located)
            if found is not None:
                tried += 1
                assert found.channel in (located.joint, n + located.joint), located.label
    assert tried > 20


def test_friction_is_bounded_only_with_nominal_value(training, tmp_path):
    recordings = load_recordings(write_case(simulated(COULOMB), tmp_path / "set"))
    stated = recordings.stated.model_copy(update={"coulomb": None})
    silent = recordings.with_nominal(stated, recordings.path)
    for given, bounded in ((recordings, True), (silent, False)):
        catalogue = {effect.name: effect for effect in remove_bounds(CATALOGUE, given)}
        assert np.isfinite(catalogue["coulomb"].amplitudes[0].upper) == bounded
        assert np.isfinite(catalogue["viscous"].amplitudes[0].upper)
