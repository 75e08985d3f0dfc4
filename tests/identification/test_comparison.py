"""Identified stiffness of several sets beside each other and beside the drivetrains' model."""

import json
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stiffopt.cli import run
from stiffopt.exact.chain import exact_windup, windup_shares
from stiffopt.identification.comparison import (
    UNCERTAINTY_FILE,
    compare_stiffness,
    describe_difference,
    write_comparison,
)
from stiffopt.identification.stiffness import identify_stiffness
from stiffopt.recording.static_set import load_static_set
from stiffopt.report.pages.identification import print_comparison
from stiffopt.robot.files import load_robot
from tests.identification.static_arms import BentArm, measure

TORQUE = 20.0


def identified(stiffness, share=0.02):
    """A joint of a set, with a relative standard deviation."""
    compliance = 1.0 / stiffness
    return SimpleNamespace(
        name="joint_1",
        status="identified",
        stiffness=stiffness,
        sd=share * stiffness,
        compliance=compliance,
        # Smaller than `sd`, which is the larger of two.
        compliance_sd=0.5 * share * compliance,
        torque=(1.0, TORQUE, 40.0),
    )


def sets(*joints):
    return [SimpleNamespace(joints=(joint,), tilt=()) for joint in joints]


def modelled(robot):
    return TORQUE / float(exact_windup(robot.chains[0], np.array([TORQUE]))[0])


def test_sets_are_pooled_with_their_scatter():
    (joint,) = compare_stiffness(sets(identified(1e5), identified(1.2e5)))
    assert 1e5 < joint.pooled < 1.2e5
    # The sets differ by far more than their own errors.
    assert joint.pooled_sd > 3.0 * 0.02 * joint.pooled / np.sqrt(2.0)
    assert joint.spread == pytest.approx(abs(1e-5 - 1 / 1.2e5) / (0.02 * np.hypot(1e-5, 1 / 1.2e5)))
    assert joint.model is None


def test_one_set_is_its_own_pool(capsys):
    joints = compare_stiffness(sets(identified(1e5)))
    assert joints[0].pooled_sd == pytest.approx(joints[0].sd[0])
    print_comparison(["one"], joints)
    assert "all sets" not in capsys.readouterr().out
    print_comparison(["one", "other"], compare_stiffness(sets(identified(1e5), identified(1.2e5))))
    out = " ".join(capsys.readouterr().out.split())
    assert "all sets" in out
    assert "J1: one is 1.20 times as soft as other; sets differ by up to" in out
    print_comparison(["one", "other"], compare_stiffness(sets(identified(1e5), identified(1.01e5))))
    assert "times as soft" not in capsys.readouterr().out


def test_joint_as_modelled_points_to_no_element():
    robot = load_robot("er3a_c60")
    (joint,) = compare_stiffness(sets(identified(modelled(robot))), robot)
    assert joint.model == pytest.approx(joint.pooled)
    assert joint.element == ""
    assert describe_difference(joint) == ""
    assert joint.bound == pytest.approx(2.0 * 0.02)


def test_softer_joint_points_to_the_element_that_explains_it():
    robot = load_robot("er3a_c60")
    shares = windup_shares(robot.chains[0], TORQUE)
    (joint,) = compare_stiffness(sets(identified(0.7 * modelled(robot))), robot)
    factor = 1.0 + (1.0 / 0.7 - 1.0) / shares[joint.element]
    assert joint.factor == pytest.approx(factor)
    # The reducer has most of the compliance and would have to change least.
    assert joint.element == max(shares, key=shares.get)
    assert joint.element in describe_difference(joint)
    assert joint.bound == pytest.approx(0.3 + 2.0 * 0.02 * 0.7)


def test_tilt_of_bearings_stands_beside_that_of_the_robot_file():
    robot = load_robot("er3a_c60", changes=["joint[1].bearing.moment_stiffness=1e5"])
    tilt = (SimpleNamespace(joint=1, compliance=2e-5),)
    results = [SimpleNamespace(joints=(identified(1e5),), tilt=own) for own in (tilt, ())]
    (joint,) = compare_stiffness(results, robot)
    assert joint.tilt == (pytest.approx(5e4), None)
    assert joint.modelled_tilt == 1e5


def test_bounds_are_those_of_a_problem_file(tmp_path):
    robot = load_robot("er3a_c60")
    unknown = replace_status(identified(1e5))
    results = [SimpleNamespace(joints=(identified(modelled(robot)), unknown), tilt=())]
    write_comparison(["before"], compare_stiffness(results, robot), tmp_path)
    bounds = tomllib.loads((tmp_path / UNCERTAINTY_FILE).read_text())["uncertainty"]["stiffness"]
    assert bounds == pytest.approx([0.04, 0.2])


def replace_status(joint):
    return SimpleNamespace(**{**vars(joint), "status": "not_loaded"})


def test_sets_of_two_arms_stand_side_by_side(tmp_path):
    soft = replace(BentArm(), stiffness=(9e5, 1e6, 1.5e6, 2.5e5, 3e5, 1.5e5))
    found = []
    for name, arm in (("first", BentArm()), ("second", soft)):
        folder = tmp_path / name
        folder.mkdir()
        recorded = load_static_set(measure(arm, 30, 3, noise=1e-6).write(folder))
        found.append(identify_stiffness(recorded, torque=False, draws=20))
    joints = compare_stiffness(found)
    assert joints[1].stiffness == pytest.approx((2e6, 1e6), rel=0.01)
    assert joints[1].spread > 10.0
    assert joints[0].spread < 4.0


def test_command_line_compares_sets_and_robot(tmp_path, capsys):
    folders = []
    for seed in (3, 4):
        folder = tmp_path / str(seed)
        folder.mkdir()
        measure(BentArm(), 20, seed, noise=1e-6).write(folder)
        folders.append(str(folder))
    out = tmp_path / "out"
    given = ["--beside", folders[1], "--robot", "er3a_c60", "--out", str(out)]
    assert run(["identify-stiffness", folders[0], *given]) == 0
    assert "Joint stiffness side by side" in capsys.readouterr().out
    joints = json.loads((out / "comparison.json").read_text())["joints"]
    assert [len(joint["stiffness"]) for joint in joints] == [2] * 6
    assert joints[0]["model"] is not None
    assert (out / UNCERTAINTY_FILE).is_file()
