"""Sentences on compensated motions, compared with the best rival."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stiffopt.command.compensation import _explain_refusal
from stiffopt.elastic.uncertainty import AssumedUncertainty, Uncertainty
from stiffopt.report.common.svg import to_svg
from stiffopt.report.solve.compensation import compensation_figure, compensation_section
from stiffopt.report.solve.wording import rival_text
from stiffopt.result.assessment import Violation
from stiffopt.result.compensation import (
    CompensatedMotion,
    Compensation,
    PartPeaks,
    Spread,
    Spreads,
)

BEYOND = Violation(limit="jerk", value=1.0, joint=1, time=0.1)


def motion(name, flight, after, duration=0.5, across=0.0):
    spreads = Spreads(
        **{
            phase: Spread(
                nominal=peak,
                worst=peak,
                worst_case="",
                worst_arm={},
                draws=np.array([peak]),
                parts={"across": PartPeaks(nominal=across, worst=across)},
            )
            for phase, peak in (("flight", flight), ("after", after))
        }
    )
    return CompensatedMotion(
        name=name,
        planned=spreads,
        compensated=spreads,
        simulated=SimpleNamespace(duration=duration),
        worst=None,
        spacing=None,
        share=1.0,
        excess=(),
    )


def compensation(*motions, **fields):
    return Compensation(
        motions=motions, command=None, uncertainty=("stiffness",), draws=1, refusal="", **fields
    )


def test_the_ratio_is_to_the_best_rival_within_the_limits():
    fast = replace(motion("toppra", 0.1, 0.1), excess=(BEYOND,))
    found = compensation(
        motion("optimised", 1.0, 2.0),
        motion("quintic", 4.0, 4.0),
        motion("S-curve", 2.0, 3.0),
        fast,
    )
    assert found.best_rival.name == "S-curve"
    assert found.ratios == (0.5, pytest.approx(2.0 / 3.0))
    assert not found.rival_wins
    text = rival_text(found)
    assert "2 times less than the best rival, the S-curve motion of 0.5 s" in text
    assert "better motion" not in text


def test_a_rival_that_wins_is_named_with_its_files():
    command = object()
    found = compensation(
        motion("optimised", 2.0, 2.0), motion("quintic", 1.0, 1.0), rival_command=command
    )
    assert found.rival_wins
    text = rival_text(found)
    assert "2 times as much as the best rival, the quintic motion" in text
    assert "rival_trajectory.csv with rival_command.csv" in text
    assert not compensation(motion("optimised", 1.01, 1.0), motion("quintic", 1.0, 1.0)).rival_wins


def test_rival_that_is_better_in_one_phase_is_handed_over_for_it():
    found = compensation(
        motion("optimised", 1.0, 1.0), motion("quintic", 2.0, 0.5), rival_command=object()
    )
    assert not found.rival_wins
    assert found.rival_better_in == ("after arrival",)
    assert "The rival is the better motion after arrival: run rival" in rival_text(found)


def test_error_across_the_path_is_compared_at_equal_duration_too():
    own, slow = motion("optimised", 1.0, 1.0, across=0.5), motion("quintic", 2.0, 2.0, 0.7, 0.3)
    found = compensation(own, slow)
    assert found.rival_better_in == ("across the path",)
    equal = replace(found, slowed={"quintic": motion("optimised", 0.5, 0.5, 0.7, 0.25)})
    assert equal.rival_better_in == ()
    assert equal.ratios == (0.25, 0.25)


def test_best_rival_is_the_one_that_is_nearest_at_equal_duration():
    """A slow rival of less error is no better than the motion slowed to its duration."""
    found = compensation(
        motion("optimised", 2.0, 2.0),
        motion("quintic", 3.0, 3.0),
        motion("toppra", 1.5, 1.5, duration=0.7),
        slowed={"toppra": motion("optimised", 0.5, 0.5, duration=0.7)},
    )
    assert found.best_rival.name == "quintic"
    assert not found.rival_wins
    slower = replace(found, slowed={"toppra": motion("optimised", 1.8, 1.8, duration=0.7)})
    assert slower.best_rival.name == "toppra"
    assert slower.rival_wins
    assert slower.ratios == (pytest.approx(1.2), pytest.approx(1.2))


def test_a_rival_wins_where_the_optimised_motion_has_no_command():
    refused = replace(motion("optimised", 1.0, 1.0), excess=(BEYOND,))
    found = compensation(refused, motion("quintic", 3.0, 3.0))
    assert found.rival_wins
    assert found.ratios is None
    text = rival_text(found)
    assert "The best rival, the quintic motion of 0.5 s, has" in text
    # It may be far slower than a fastest motion.
    assert "better motion" not in text
    assert text.endswith("Of the two only the rival's motors can lead its links.")
    assert compensation(refused).best_rival is None


@pytest.mark.parametrize("uncertainty", [Uncertainty(), AssumedUncertainty()])
def test_refusal_of_a_fastest_motion_advises_what_is_not_stated_yet(uncertainty):
    objectives = (SimpleNamespace(name="duration"),)
    told = _explain_refusal(
        SimpleNamespace(objectives=objectives, uncertainty=uncertainty), (BEYOND,)
    )
    assert "limits.scale.jerk" in told
    assert ("State [uncertainty]" in told) is not uncertainty.stated


@pytest.mark.parametrize(("after", "ticks"), [(2e-5, {"0.02", "0.03"}), (2e-8, {"0.0001", "0.01"})])
def test_ticks_of_deviations_over_decades_are_numbers(after, ticks):
    found = compensation(motion("optimised", 5e-5, after), motion("quintic", 6e-5, 3e-5))
    drawn = to_svg(compensation_figure(found), "compensation", "Deviations")
    assert "mathdefault" not in drawn
    assert ticks <= set(re.findall(r">([0-9.]+)<", drawn))


def test_a_stored_command_is_not_said_to_be_slowed():
    found = compensation(motion("optimised", 1e-4, 3e-5), motion("quintic", 2e-4, 2e-5, 0.6))
    assert "slowed" in " ".join(compensation_section(found).lines)
    stored = compensation_section(replace(found, file="command.csv"))
    assert "slowed" not in " ".join(stored.lines)
