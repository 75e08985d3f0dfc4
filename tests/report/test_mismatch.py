"""What a mismatch is made of, in words, at the edges: next to nothing, and less than nothing."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from stiffopt.discovery.judging.explained_shares import ExtensionPart, MismatchShare
from stiffopt.discovery.search.rigid_model import BODY_WIDTHS, Counterweight, RigidStage
from stiffopt.report.diagnosis.mismatch import (
    _channels,
    _probabilities,
    _range,
    _span,
    counterbalance_sentences,
    mismatches,
)

OFFSETS = ExtensionPart(kind="usual")


def told(part, left, part_of=OFFSETS, kinds=("torque",), rigid=None, moved=()):
    """The sentence of one part and of what is open; nominal values moved by name, over one sd."""
    names, changes = [name for name, _ in moved], np.array([value for _, value in moved])
    diagnosis = SimpleNamespace(
        findings=(None,),
        shares=[
            MismatchShare(part=part_of, measured="torque", share=part),
            MismatchShare(part=None, measured="torque", share=left),
        ],
        held_out=[SimpleNamespace(channels=[SimpleNamespace(kind=kind) for kind in kinds])],
        search=SimpleNamespace(
            rigid=rigid,
            comparison=SimpleNamespace(nuisance=(names, np.full(len(names), 0.3), None)),
            fit=SimpleNamespace(posterior=SimpleNamespace(mean=changes)),
        ),
    )
    (only,) = mismatches(diagnosis)
    return only.sentence


@pytest.mark.parametrize(
    ("left", "words"),
    [(-0.003, "0 %"), (0.0, "0 %"), (1e-8, "below 0.1 %"), (0.004, "0.4 %"), (0.2, "20 %")],
)
def test_what_is_open_is_never_less_than_nothing(left, words):
    assert told(0.9, left) == f"Of the mismatch on runs left out: 90 % offsets, {words} open."


def test_a_part_may_do_harm():
    assert told(-0.2, 1.2).endswith("120 % open. There it is made worse: offsets by 20 %.")


def test_encoders_within_their_noise_are_not_spoken_of():
    assert told(0.9, 0.1, kinds=("torque", "link_position")).startswith(
        "Of the mismatch of the torques on runs left out: "
    )


@pytest.mark.parametrize(("width", "freed"), [(BODY_WIDTHS[1], False), (BODY_WIDTHS[2], True)])
def test_bodies_that_are_all_held_are_not_reidentified(width, freed):
    rigid = RigidStage(widths=(BODY_WIDTHS[0], width), gain=20.0, single=None)
    assert ("re-identified" in told(0.9, 0.1, ExtensionPart(kind="nominal"), rigid=rigid)) == freed


@pytest.mark.parametrize(
    ("moved", "share", "words"),
    [
        ((("viscous 1", 0.1), ("coulomb 3", 0.7)), 0.96, "Coulomb friction of joint 3: +70 %"),
        ((("mass 5", -0.4),), 0.96, "mass behind joint 5: -40 %"),
        ((("com 2 z", 0.31),), 0.96, "centre of mass z behind joint 2: 0.31 m"),
        ((("coulomb 3", 0.2),), 0.96, ""),
        ((("coulomb 3", 0.7),), 0.1, ""),
    ],
)
def test_the_nominal_value_that_moved_most_is_told(moved, share, words):
    said = told(share, 1.0 - share, ExtensionPart(kind="nominal"), moved=moved)
    assert (f"within their tolerances (most of all {words})" in said) == bool(words)
    assert ("most of all" in said) == bool(words)


@pytest.mark.parametrize(
    ("gain", "words"),
    [(70.0, "likelier a counterbalance"), (0.5, "do not tell"), (-math.inf, "do not tell")],
)
def test_a_counterbalance_is_told_beside_the_weight_that_it_is_like(gain, words):
    weight = Counterweight(joint=1, nominal=160.0, change=595.0, gain=gain)
    rigid = RigidStage(widths=(BODY_WIDTHS[2],), gain=20.0, single=None, counterweights=(weight,))
    constants = SimpleNamespace(links=["a", "b"], joints=[SimpleNamespace(prismatic=False)] * 2)
    diagnosis = SimpleNamespace(
        search=SimpleNamespace(rigid=rigid), training=SimpleNamespace(constants=constants)
    )
    (said,) = counterbalance_sentences(diagnosis)
    assert said.startswith("Counterbalance of joint 2, or the weight of b")
    assert words in said
    assert "up to 5800 N m" in said
    short = told(0.9, 0.1, ExtensionPart(kind="nominal"), rigid=rigid)
    assert ("likely a counterbalance of joint 2" in short) == (gain > 2.0)


def test_shares_are_rounded_before_they_are_told():
    assert _range(-0.001, 0.03) == "0 to 3 %"
    assert _range(-0.001, 0.001) == "0 %"
    assert _range(np.float64(0.1), np.float64(0.5)) == "10 to 50 %"


def test_groups_say_from_which_to_which():
    assert _span([3.2, 15.4], 1) == "3 to 15"
    assert _span([3.2, 3.3], 1) == "3"
    assert _span([155.2, 0.123], 2) == "0.12 to 155"
    assert _channels(["torque_1", "torque_3", "torque_2"]) == "torques of joints 1 to 3"
    assert _channels(["link_position_2"]) == "link encoder of joint 2"
    assert _probabilities([0.6, 0.999]) == "60 to above 99 %"
    assert _probabilities([0.6]) == "60 %"
