"""Robots exported from a diagnosis of commanded positions carry the fitted simulation's values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_arms import ROOT

from stiffopt.closed_loop.parameters import BODY_PARAMETERS, JOINT_PARAMETERS
from stiffopt.discovery.extended.schema import ClosedLoopSection
from stiffopt.discovery.extended.value_changes import value_changes
from stiffopt.export.model_format import DiagnosedRobot, _with_closed_loop
from stiffopt.recording.recording_set import load_recordings


@pytest.fixture(scope="module")
def nominal():
    return load_recordings(ROOT / "problems" / "recordings" / "two_link_friction").robot


def exported(nominal, order, **fitted):
    values = dict.fromkeys((*JOINT_PARAMETERS, *BODY_PARAMETERS), (0.0, 0.0)) | fitted
    loop = ClosedLoopSection.model_validate(
        {
            "stiffness": (20.0, 10.0),
            "damping": (1.5, 0.5),
            "drive_max": (np.inf, np.inf),
            "torque_max": (np.inf, np.inf),
            "tolerance": (0.1, 0.1),
            "middle": (0.0, 0.0),
            "delay": 0.004,
            "values": values,
            "deviations": {name: (0.0,) * len(each) for name, each in values.items()},
        }
    )
    nan = np.full(2, np.nan)
    found = DiagnosedRobot(
        name="set", nominal=nominal, robot=nominal, gain=np.ones(2), zeros=np.zeros(2),
        stiffness=nan, damping=nan, changes=(), left_out=("of the search",),
    )  # fmt: skip
    return _with_closed_loop(found, loop, np.array(order))


def test_fitted_values_replace_those_of_the_search(nominal):
    found = exported(
        nominal,
        [1, 0],
        coulomb=(0.2, 0.3),
        armature=(0.01, 0.02),
        gain=(0.1, 0.0),
        zero=(0.05, 0.0),
        load_friction=(0.0, 0.07),
        deadband=(0.002, 0.0),
    )
    # The set's first joint is the robot's second.
    np.testing.assert_allclose(found.robot.coulomb, [0.3, 0.2])
    np.testing.assert_allclose(found.robot.rotor_inertia, [0.02, 0.01])
    np.testing.assert_allclose(found.stiffness, [10.0, 22.0])
    np.testing.assert_allclose(found.zeros, [0.0, -0.05])
    # Physics that is no parameter of the simulation is in no robot file either.
    left_out = ("load_friction of joint 1", "deadband of joint 2")
    assert found.left_out == ("of the search", *left_out)


def test_fitted_bodies_are_those_of_the_robot(nominal):
    found = exported(nominal, [0, 1], mass=(0.0, 0.1), mcx=(0.0, 0.03), Izz=(0.0, 0.002))
    before, after = (r.tree.bodies[1].inertial_parameters for r in (nominal, found.robot))
    expected = 0.1 * before
    expected[[1, 9]] += 0.03, 0.002
    np.testing.assert_allclose(after - before, expected, atol=1e-12)
    np.testing.assert_array_equal(
        found.robot.tree.bodies[0].inertial_parameters, nominal.tree.bodies[0].inertial_parameters
    )


def test_changed_values_have_the_numbers_of_the_set(nominal):
    stiffer = replace(nominal, coulomb=nominal.coulomb + np.array([0.0, 1.0]))
    (change,) = value_changes(nominal, stiffer, order=np.array([1, 0]))
    assert (change.joint, change.name) == (1, nominal.joint_names[1])
