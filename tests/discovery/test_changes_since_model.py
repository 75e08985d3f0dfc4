"""A diagnosis that starts from an extended model: what that model left open is no change."""

from pathlib import Path

import numpy as np
import pytest

from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.channel_rows import ChannelNoise
from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect
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


def test_noise_factors_are_at_least_one():
    np.testing.assert_allclose(section().torque, [0.5, 0.1])
    np.testing.assert_allclose(section().link_position, [0.0, 3e-5])
    np.testing.assert_allclose(noise_factors(section(), NOISE), [5.0, 1.0, np.nan, 3.0])
    assert noise_factors(None, NOISE) is None


def test_open_residual_is_larger_noise_at_higher_rate():
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


def test_bands_of_model_are_adopted_unless_stated():
    assert adopt_bands(Settings(), section()) == CHOSEN
    assert adopt_bands(Settings(cutoff=5.0), section()).cutoff == 5.0
    # Where links swing no bands are chosen, and none are taken over.
    unchosen = section().model_copy(update={"predict": None})
    assert adopt_bands(Settings(), unchosen) == Settings()


def test_left_open_section_round_trip():
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
def test_invalid_bands_and_steps_are_refused(kind, entry):
    sound = {
        LeftOpenSection: section().model_dump(exclude_none=True),
        EffectSection: {"name": "coulomb", "joint": 1, "step": -2.5, "term": {"dFc": 0.1}},
    }[kind]
    assert validate(kind, sound, Path("x"))
    with pytest.raises(InputFileError, match=next(iter(entry))):
        validate(kind, sound | entry, Path("x"))


def test_refit_step_is_removed_for_the_fit():
    effect = next(each for each in CATALOGUE if each.name == "coulomb")
    found = EstimatedEffect(
        located=LocatedEffect(effect=effect, joint=0), amplitudes=(13.0,), step=-2.5
    )
    (fitted,) = Extension(effects=(found,)).fitted.effects
    assert fitted.amplitudes == (15.5,)
    assert fitted.step == 0.0


@pytest.mark.parametrize("name", ["payload", "inertial_error"])
def test_changes_of_bodies_have_wider_amplitudes(name):
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
def test_changes_of_torque_gain_have_wider_amplitudes(name):
    """Eight times what a model left of a UR10's joint 4 is 23 % of what that is rated for."""

    class Joint:
        torque_rated = 17.8

    (usual,) = [each for each in CATALOGUE if each.name == name]
    (wide,) = widen_for_changes([usual])
    most = [each.upper * each.size(Joint()) for each in wide.amplitudes]
    assert all(0.5 * Joint.torque_rated < each < 1.5 * Joint.torque_rated for each in most)
