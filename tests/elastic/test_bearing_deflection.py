"""Deflection of output bearings, against bearings that are joints of their own on springs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from tilting_arms import tilting_arm

from stiffopt.errors import InputFileError
from stiffopt.robot.bearings import bearing_deflections
from stiffopt.robot.files import load_robot
from stiffopt.robot.robot import Robot

_NAMES = ("csf_2uh_20", "csf_2uh_25", "csf_2uh_20", "fha_11", "fha_8", "fha_8")
_BEARINGS = [f'joint[{j}].bearing.catalogue="{name}"' for j, name in enumerate(_NAMES, start=1)]


def _arm(*changes: str) -> Robot:
    return load_robot("er3a_c60", changes=changes).with_payload(2.0, (0.0, 0.0, 0.05))


@pytest.mark.parametrize("name", ["catalogue", "all components"])
def test_deflection_equals_that_of_finite_rotations(name: str) -> None:
    changes = list(_BEARINGS)
    if name == "all components":
        changes += [
            'joint[2].bearing.axial_stiffness="100 N/um"',
            'joint[2].bearing.radial_stiffness="60 N/um"',
            'joint[2].bearing.position="40 mm"',
            'joint[4].bearing.radial_stiffness="20 N/um"',
            'joint[4].bearing.position="-30 mm"',
        ]
    robot, force = _arm(*changes), np.array([50.0, -30.0, 20.0])
    arm = tilting_arm(robot)
    for q in np.random.default_rng(3).uniform(-1.0, 1.0, (4, 6)):
        unloaded = np.zeros(len(arm.stiffness))
        unloaded[arm.driven] = q
        rigid, loaded = arm.tool_pose(unloaded), arm.tool_pose(arm.static_position(q, force))
        moved = loaded.translation - rigid.translation
        turned = pin.log3(loaded.rotation @ rigid.rotation.T)
        found = bearing_deflections(robot, q[None], force=force)[0].sum(axis=0)
        # Terms of second order are left out.
        np.testing.assert_allclose(found[:3], moved, atol=3e-3 * np.linalg.norm(moved))
        np.testing.assert_allclose(found[3:], turned, atol=3e-3 * np.linalg.norm(turned))


def test_rigid_bearings_deflect_nothing() -> None:
    assert not bearing_deflections(_arm(), np.ones((2, 6))).any()


def test_bearing_without_stiffness_is_refused() -> None:
    with pytest.raises(InputFileError, match=r"joint\[joint_2\].bearing.*moment_stiffness"):
        load_robot("er3a_c60", changes=['joint[2].bearing.position="10 mm"'])


def test_unknown_bearing_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(InputFileError, match="csf_2uh_25"):
        load_robot("er3a_c60", changes=['joint[2].bearing.catalogue="csf_2uh_26"'])


def test_file_overrides_the_catalogue() -> None:
    robot = load_robot(
        "er3a_c60",
        changes=['joint[2].bearing.catalogue="fha_8"', "joint[2].bearing.moment_stiffness=3e4"],
    )
    bearing = robot.bearings[1]
    assert bearing is not None
    assert bearing.moment_stiffness == 3e4
