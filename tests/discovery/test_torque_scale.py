"""Friction in newton metres is no surer than the constant that turns currents into torques."""

from __future__ import annotations

from dataclasses import replace

import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.judging.added_uncertainty import add_scale_deviation
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import estimate_parameters
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


@pytest.mark.parametrize("channel", ["torque", "link_position"])
def test_torque_constant_uncertainty_adds_to_amplitudes(channel: str) -> None:
    training = prepare_training(load_recordings(SHIPPED), Settings())
    joint, joints = 1, training.robot.n
    number = joint if channel == "torque" else joints + joint
    friction = replace(effect("coulomb"), nominal="")
    there = Selected(LocatedEffect(effect=friction, joint=joint), 1.0, 1.0, 1.0, (), number)
    before = estimate_parameters(training.comparison(), [there.located])
    after = add_scale_deviation(before, [there])
    constants = there.located.constants(training.constants)
    (value, sd), (same, wider) = (each.parameters(0, constants)["dFc"] for each in (before, after))
    open_ = before.covariance[(k := before.nuisance.index(ValueName("torque_constant", joint))), k]
    assert same == value
    assert open_ > 0.0
    if channel == "torque":
        assert wider**2 == pytest.approx(sd**2 + open_ * value**2, rel=1e-9)
    else:
        assert wider == sd
