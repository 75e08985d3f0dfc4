"""Shapes that contradict the recordings are never reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect, effect_places
from stiffopt.discovery.identifiable import EffectCheck, restrict_to_identifiable
from stiffopt.discovery.judging.unexplained import _find_period
from stiffopt.discovery.signals import JointConstants, RobotConstants

JOINT = JointConstants(
    joint=1,
    ratio=100.0,
    coulomb=4.0,
    viscous=0.0,
    torque_rated=40.0,
    torque_max=120.0,
    rotor_inertia=0.0,
    measured_torque=60.0,
)
ROBOT = RobotConstants(
    joints=(JOINT, replace(JOINT, joint=2)),
    links=("link1", "link2"),
    masses=np.ones(2),
    centres=np.zeros((2, 3)),
    tool_range=np.zeros((2, 3)),
)


def test_limits_are_sought_where_torques_are_read() -> None:
    """A drive is asked for more than it gives, a reading ends at its largest values."""
    asked = [place.shapes[0] for place in _places("saturation")]
    read = [place.shapes[0] for place in _places("reading_limit")]
    # Of 60 N m read and 120 N m at most.
    assert all(0.05 < share < 0.5 for share in asked)
    assert read == [0.5]


def _places(name: str) -> list[LocatedEffect]:
    return [each for each in effect_places(effect(name), ROBOT, ["run"]) if each.joint == 0]


@pytest.mark.parametrize(("share", "possible"), [(0.3, False), (0.45, False), (0.5, True)])
def test_reading_limit_below_measured_torque_is_refused(share: float, possible: bool) -> None:
    """Of 60 N m measured and 120 N m at most, a limit below half was passed and is none."""
    limit = LocatedEffect(effect=effect("reading_limit"), joint=0, shapes=(share,))
    assert limit.possible(ROBOT) == possible


@pytest.mark.parametrize(
    ("place", "width", "possible"), [(0.5, 0.3, True), (4.0, 0.3, False), (0.0, 1.5, False)]
)
def test_position_friction_outside_stroke_is_refused(
    place: float, width: float, possible: bool
) -> None:
    """Of a stroke of 2 rad: one beyond it is never met, one as wide is Coulomb friction."""
    joint = replace(JOINT, stroke=(-1.0, 1.0))
    bump = LocatedEffect(effect=effect("position_friction"), joint=0, shapes=(place, width))
    assert bump.possible(replace(ROBOT, joints=(joint,))) == possible


def test_a_tight_place_of_a_slider_is_sought_by_its_stroke() -> None:
    """In metres: .3 rad of a joint that turns is wider than the whole stroke."""
    robot = replace(ROBOT, joints=(replace(JOINT, stroke=(0.1, 0.3)),))
    entry = effect("position_friction")
    widths = entry.shapes[1].start_values(robot.joints[0])
    assert widths == pytest.approx((0.024, 0.06, 0.14))
    for width, possible in ((0.02, True), (0.005, False), (0.11, False)):
        bump = LocatedEffect(effect=entry, joint=0, shapes=(0.2, width))
        assert bump.possible(robot) == possible


@pytest.mark.parametrize(
    ("name", "least"), [("coulomb", -4.0), ("viscous", 0.0), ("rotor_inertia", 0.0)]
)
def test_amplitude_bounds_keep_nominal_sum_nonnegative(name: str, least: float) -> None:
    """A change takes away at most what the nominal model has; of nothing it takes nothing."""
    located = LocatedEffect(effect=effect(name), joint=0)
    assert located.bounds(ROBOT)[0, 0] * located.sizes(ROBOT)[0] == pytest.approx(least)


def test_effect_is_sought_only_where_identifiable() -> None:
    """What `recording check` says cannot be told of a joint is not tried there."""
    entry = effect("coulomb")
    checks = [
        EffectCheck(effect=entry, joint=1, lacks=("it does not move",)),
        EffectCheck(effect=entry, joint=2, lacks=()),
    ]
    (told,) = restrict_to_identifiable([entry], checks)
    assert told.applies is not None
    assert [told.applies(joint) for joint in ROBOT.joints] == [False, True]


def test_short_block_has_no_period() -> None:
    """Three rows a block resolve no wave; that is an answer, not an error."""
    block = np.repeat([0, 1], 3)
    time = np.array([0.0, 0.1, 0.2, 1.0, 1.1, 1.2])
    assert _find_period(np.ones(6), block, time) is None
