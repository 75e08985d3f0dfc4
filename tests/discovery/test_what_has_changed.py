"""A diagnosis that starts from an extended model: what that model left open is no change."""

from pathlib import Path

import numpy as np
import pytest

from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.extension import EstimatedEffect, Extension
from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.rows import ChannelNoise
from stiffopt.discovery.extended.left_open import (
    adopt_bands,
    left_open_section,
    noise_factors,
    rescale_to_rate,
)
from stiffopt.discovery.extended.schema import EffectSection, LeftOpenSection
from stiffopt.discovery.identifiable import widen_for_changes
from stiffopt.discovery.settings import Settings
from stiffopt.errors import InputFileError
from stiffopt.validation import validate

NOISE = ChannelNoise(np.array([0.1, 0.2]), np.array([np.nan, 1e-5]))
CHOSEN = Settings(cutoff=8.0, predict=(6.0, 20.0))


def section() -> LeftOpenSection:
    ratio = np.array([5.0, 0.5, np.nan, 3.0])
    return left_open_section(
        ratio, NOISE, CHOSEN, {"stribeck of joint 1": 0.01}, {"coulomb of joint 2": (-0.3,)}
    )


def test_what_is_left_comes_back_as_factors_of_at_least_one():
    np.testing.assert_allclose(section().torque, [0.5, 0.1])
    np.testing.assert_allclose(section().link_position, [0.0, 3e-5])
    np.testing.assert_allclose(noise_factors(section(), NOISE), [5.0, 1.0, np.nan, 3.0])
    assert noise_factors(None, NOISE) is None


def test_what_is_left_in_the_band_is_noise_of_more_at_a_faster_clock():
    own = section()
    # A file that tells no clock is of the one that it is compared at.
    known = rescale_to_rate(own, 100.0)
    assert known.torque == own.torque
    faster = rescale_to_rate(known, 900.0)
    np.testing.assert_allclose(faster.torque, np.multiply(3.0, own.torque))
    np.testing.assert_allclose(faster.link_position, np.multiply(3.0, own.link_position))
    np.testing.assert_allclose(rescale_to_rate(faster, 100.0).torque, own.torque)
    # As large in the band: the filter leaves the root of cutoff over clock of white noise.
    gains = [ZeroPhaseFilter(rate, 8.0).noise_gain for rate in (100.0, 900.0)]
    np.testing.assert_allclose(gains[0] * own.torque[0], gains[1] * faster.torque[0], rtol=0.01)


def test_bands_of_the_model_are_taken_unless_others_are_asked_for():
    assert adopt_bands(Settings(), section()) == CHOSEN
    assert adopt_bands(Settings(cutoff=5.0), section()).cutoff == 5.0
    # Where links swing no bands are chosen, and none are taken over.
    unchosen = section().model_copy(update={"predict": None})
    assert adopt_bands(Settings(), unchosen) == Settings()


def test_the_section_is_read_as_it_is_written():
    again = validate(LeftOpenSection, section().model_dump(exclude_none=True), Path("x"))
    assert again == section()


@pytest.mark.parametrize(
    ("kind", "entry"),
    [
        (LeftOpenSection, {"cutoff": 1e9}),
        (LeftOpenSection, {"predict": [6.0, 1e9]}),
        (EffectSection, {"step": 1e300}),
        (EffectSection, {"step": -1e300}),
    ],
)
def test_bands_and_steps_that_cannot_be_are_refused(kind, entry):
    sound = {
        LeftOpenSection: section().model_dump(exclude_none=True),
        EffectSection: {"name": "coulomb", "joint": 1, "step": -2.5, "term": {"dFc": 0.1}},
    }[kind]
    assert validate(kind, sound, Path("x"))
    with pytest.raises(InputFileError, match=f"{next(iter(entry))}.* cannot be used"):
        validate(kind, sound | entry, Path("x"))


def test_a_step_to_all_moving_samples_is_taken_back_for_the_fit():
    effect = next(each for each in CATALOGUE if each.name == "coulomb")
    found = EstimatedEffect(
        located=LocatedEffect(effect=effect, joint=0), amplitudes=(13.0,), step=-2.5
    )
    (fitted,) = Extension(effects=(found,)).fitted.effects
    assert fitted.amplitudes == (15.5,)
    assert fitted.step == 0.0


@pytest.mark.parametrize("name", ["payload", "inertial_error"])
def test_bodies_change_by_more_than_what_nobody_has_weighed_is_off(name):
    class Arm:
        masses = np.array([10.0, 5.0])

    (usual,) = [each for each in CATALOGUE if each.name == name]
    (wide,) = widen_for_changes([usual])
    times = [
        new.size(Arm()) / old.size(Arm())
        for old, new in zip(usual.amplitudes, wide.amplitudes, strict=True)
    ]
    np.testing.assert_allclose(times, [3.0] + 3 * [9.0] + 6 * [27.0])


@pytest.mark.parametrize("name", ["torque_offset", "torque_ripple", "rotor_ripple"])
def test_what_a_drive_reads_wrongly_since_is_more_than_it_is_off_as_it_was_built(name):
    """Eight times what a model left of a UR10's joint 4 is 23 % of what that is rated for."""

    class Joint:
        torque_rated = 17.8

    (usual,) = [each for each in CATALOGUE if each.name == name]
    (wide,) = widen_for_changes([usual])
    most = [each.upper * each.size(Joint()) for each in wide.amplitudes]
    assert all(0.5 * Joint.torque_rated < each < 1.5 * Joint.torque_rated for each in most)
