"""Findings that help only where they were fitted are no findings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search.left_out import _excess, borne_out
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import LEFT_OUT_SHARE
from stiffopt.discovery.training import train
from stiffopt.recording.recording_set import load_recordings

SET = Path(__file__).parents[2] / "problems" / "recordings" / "two_link_friction"


def test_what_is_there_stays_and_what_is_not_goes() -> None:
    """More dry friction in joint 2 is in every run, load friction of joint 1 in none."""
    comparison = train(load_recordings(SET), Settings()).comparison()
    there = LocatedEffect(effect=effect("coulomb"), joint=1)
    load = LocatedEffect(effect=effect("load_friction"), joint=0)
    assert borne_out(comparison, [load, there]) == [there]


@pytest.mark.parametrize(
    ("falls", "borne"),
    [
        ([3.0, 2.0, 4.0], True),  # of 100 in each
        ([9.0, -0.1, -0.1], False),  # one part alone
        ([9.0, 0.1, -9.0], False),  # as much lost as gained
        ([0.2, 0.2, 0.2], False),  # next to nothing
    ],
)
def test_a_finding_helps_in_most_parts(falls: list[float], borne: bool) -> None:
    """By the squares that it takes away in parts that no fit saw."""
    without = np.full((3, 1), 100.0)
    excess = _excess(without - np.array(falls)[:, None], without)
    assert (excess >= 0.0) == borne
    if borne:
        assert excess == pytest.approx(0.03 - LEFT_OUT_SHARE)
