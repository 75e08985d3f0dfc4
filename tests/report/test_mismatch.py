"""Sentences on the composition of a mismatch in limiting cases: zero and negative shares."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from stiffopt.discovery.judging.explained_shares import ExtensionPart, MismatchShare
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.search.rigid_model import (
    HELD_WIDTH,
    PRIOR_WIDTHS,
    Counterweight,
    RigidStage,
)
from stiffopt.report.diagnosis.mismatch import (
    counterbalance_sentences,
    format_probability_range,
    format_share_range,
    mismatches,
)

OFFSETS = ExtensionPart(kind="usual")


def told(part, left, part_of=OFFSETS, kinds=("torque",), rigid=None, moved=()):
    """Return the sentence of one part and the unexplained share; nominal values moved by name."""
    names, changes = [name for name, _ in moved], np.array([value for _, value in moved])
    diagnosis = SimpleNamespace(
        findings=(None,),
        shares=[
            MismatchShare(part=part_of, measured="torque", share=part),
            MismatchShare(part=None, measured="torque", share=left),
        ],
        held_out=[SimpleNamespace(channels=[SimpleNamespace(kind=kind) for kind in kinds])],
        training=SimpleNamespace(box=4.0),
        search=SimpleNamespace(
            rigid=rigid,
            comparison=SimpleNamespace(priors=(names, np.full(len(names), 0.3))),
            fit=SimpleNamespace(posterior=SimpleNamespace(mean=changes)),
        ),
    )
    (only,) = mismatches(diagnosis)
    return only.sentence


@pytest.mark.parametrize(
    ("left", "words"),
    [(-0.003, "0 %"), (0.0, "0 %"), (1e-8, "below 0.1 %"), (0.004, "0.4 %"), (0.2, "20 %")],
)
def test_unexplained_share_is_never_negative(left, words):
    assert told(0.9, left) == f"Mismatch on held-out runs: 90 % offsets, {words} unexplained."


def test_negative_share_is_reported_as_increase():
    assert told(-0.2, 1.2).endswith("120 % unexplained. Increased by offsets (20 %).")


def test_channels_within_noise_have_no_mismatch():
    assert told(0.9, 0.1, kinds=("torque", "link_position")).startswith(
        "Mismatch of the torques on held-out runs: "
    )


@pytest.mark.parametrize(("width", "freed"), [(HELD_WIDTH, False), (PRIOR_WIDTHS[0], True)])
def test_fixed_bodies_are_not_reported_as_reidentified(width, freed):
    rigid = RigidStage(widths=(HELD_WIDTH, width), gain=20.0, single=None)
    assert ("re-identified" in told(0.9, 0.1, ExtensionPart(kind="nominal"), rigid=rigid)) == freed


@pytest.mark.parametrize(
    ("moved", "share", "words"),
    [
        (
            ((ValueName("viscous", 0), 0.1), (ValueName("coulomb", 2), 0.7)),
            0.96,
            "Coulomb friction of joint 3: +70 %",
        ),
        (((ValueName("mass", 4), -0.4),), 0.96, "mass behind joint 5: -40 %"),
        (((ValueName("com", 1, "z"), 0.31),), 0.96, "centre of mass z behind joint 2: 0.31 m"),
        (((ValueName("coulomb", 2), 0.2),), 0.96, ""),
        (((ValueName("coulomb", 2), 0.7),), 0.1, ""),
    ],
)
def test_largest_moved_nominal_value_is_named(moved, share, words):
    said = told(share, 1.0 - share, ExtensionPart(kind="nominal"), moved=moved)
    assert (f"within their tolerances (mainly {words})" in said) == bool(words)
    assert ("mainly" in said) == bool(words)


@pytest.mark.parametrize(
    ("gain", "words"),
    [(70.0, "is more likely"), (0.5, "do not separate"), (-math.inf, "do not separate")],
)
def test_counterbalance_is_reported_as_alternative_to_weight(gain, words):
    weight = Counterweight(joint=1, nominal=160.0, change=595.0, gain=gain)
    rigid = RigidStage(widths=(PRIOR_WIDTHS[0],), gain=20.0, single=None, counterweights=(weight,))
    constants = SimpleNamespace(links=["a", "b"], joints=[SimpleNamespace(prismatic=False)] * 2)
    diagnosis = SimpleNamespace(
        search=SimpleNamespace(rigid=rigid), training=SimpleNamespace(constants=constants)
    )
    (said,) = counterbalance_sentences(diagnosis)
    assert said.startswith("Counterbalance of joint 2 or weight of b")
    assert words in said
    assert "up to 5800 N m" in said
    short = told(0.9, 0.1, ExtensionPart(kind="nominal"), rigid=rigid)
    assert ("likely a counterbalance of joint 2" in short) == (gain > 2.0)


def test_share_ranges_are_rounded():
    assert format_share_range(-0.001, 0.03) == "0 to 3 %"
    assert format_share_range(-0.001, 0.001) == "0 %"
    assert format_share_range(np.float64(0.1), np.float64(0.5)) == "10 to 50 %"


def test_probability_ranges():
    assert format_probability_range([0.6, 0.999]) == "60 to above 99 %"
    assert format_probability_range([0.6]) == "60 %"
