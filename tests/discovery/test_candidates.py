"""Candidates judged: what a candidate is about, and how large it may be."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_sets import COULOMB, simulated

from benchmarks.simulator import write_case
from stiffopt.discovery.catalogue import CATALOGUE, effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect, effect_places
from stiffopt.discovery.identifiable import remove_bounds
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import NAMED_SHARE
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
    for entry in CATALOGUE:
        if entry.scope != "joint" or entry.couples_joints:
            continue
        for located in effect_places(
            entry, comparison.constants, [run.name for run in comparison.runs]
        ):
            found = scorer.score(located)
            if found is not None:
                tried += 1
                assert found.channel in (located.joint, n + located.joint), located.label
    assert tried > 20


def test_correction_of_a_form_is_a_small_share_of_it(training):
    """Dry friction fitted by a bump leaves a residual of which a box explains a quarter."""
    start = training.comparison()
    bump = LocatedEffect(effect=effect("position_friction"), joint=1, shapes=(0.5, 1.0))
    box = LocatedEffect(effect=effect("stroke_friction"), joint=1, shapes=(0.11, 0.66))
    comparison = start.linearised_at(start.fit([bump]))
    for other, same in ((bump, True), (replace(bump, calibrated=True), False)):
        added = Scorer(comparison, [other]).score(box)
        assert added is not None
        assert (added.explained < NAMED_SHARE) == same


def test_friction_is_bounded_only_with_nominal_value(training, tmp_path):
    recordings = load_recordings(write_case(simulated(COULOMB), tmp_path / "set"))
    stated = recordings.stated.model_copy(update={"coulomb": None})
    silent = recordings.with_nominal(stated, recordings.path)
    for given, bounded in ((recordings, True), (silent, False)):
        catalogue = {effect.name: effect for effect in remove_bounds(CATALOGUE, given)}
        assert np.isfinite(catalogue["coulomb"].amplitudes[0].upper) == bounded
        assert np.isfinite(catalogue["viscous"].amplitudes[0].upper)
