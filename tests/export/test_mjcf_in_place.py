"""MJCFs changed in place: values of the diagnosed robot, all else as it was."""

from __future__ import annotations

import csv
import difflib
from dataclasses import replace

import numpy as np
import pytest
from mjcf_models import write_arm

from stiffopt.export.model_format import MODEL_FORMATS, DiagnosedRobot
from stiffopt.robot.files import load_robot
from stiffopt.robot.mjcf import read_mjcf

pytest.importorskip("mujoco")


def load(path):
    joints = "".join(
        f'[[joint]]\nname = "{name}"\ntorque_max = 50.0\nvelocity_max = 2.0\n'
        for name in ("pan", "lift", "slide", "roll")
    )
    (path.parent / "robot.toml").write_text(
        f'schema = 1\nkind = "robot"\nname = "odd"\nurdf = "{path.name}"\n{joints}'
    )
    return load_robot(path.parent / "robot.toml")


@pytest.fixture
def nominal(tmp_path):
    return load(write_arm(tmp_path))


UNKNOWN = (np.nan,) * 4


def diagnosed(
    nominal, robot=None, gain=(1.0,) * 4, zeros=(0.0,) * 4, stiffness=UNKNOWN, damping=UNKNOWN
):
    return DiagnosedRobot(
        name="found",
        nominal=nominal,
        robot=robot or nominal,
        gain=np.array(gain),
        zeros=np.array(zeros),
        stiffness=np.array(stiffness),
        damping=np.array(damping),
        changes=(),
        left_out=(),
    )


def written(found, folder):
    """Write the export as the user would: over a copy of the file's folder."""
    exported = MODEL_FORMATS["mjcf"].export(found)
    for name, content in exported.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    table = list(csv.DictReader((folder / "mjcf_changes.csv").read_text().splitlines()))
    return load(folder / "arm" / "odd.xml"), table, exported.remarks


def changed_lines(before, after):
    pairs = difflib.ndiff(before.splitlines(), after.splitlines())
    return [line for line in pairs if line.startswith(("- ", "+ "))]


def test_unchanged_robot_leaves_every_byte(nominal, tmp_path):
    exported = MODEL_FORMATS["mjcf"].export(diagnosed(nominal))
    assert exported.remarks == ()
    for name in ("arm/odd.xml", "parts/defaults.xml"):
        assert exported.files[name] == (tmp_path / name).read_bytes()


def test_friction_and_armature_are_set_on_the_joint_alone(nominal, tmp_path):
    friction, armature = nominal.coulomb.copy(), nominal.rotor_inertia.copy()
    friction[0], armature[2] = 1.9, 0.25
    robot = replace(nominal, coulomb=friction, rotor_inertia=armature)
    (tmp_path / "out").mkdir()
    again, table, _ = written(diagnosed(nominal, robot), tmp_path / "out")
    assert again.coulomb == pytest.approx(friction, abs=1e-12)
    assert again.rotor_inertia == pytest.approx(armature, abs=1e-12)
    lines = changed_lines(
        *((p / "arm" / "odd.xml").read_text() for p in (tmp_path, tmp_path / "out"))
    )
    assert len(lines) == 4
    assert '<joint name="pan" axis="0 1 1" range="-100 120" ref="25"' in lines[1]
    assert [(row["name"], row["attribute"], row["old"], row["new"]) for row in table] == [
        ("pan", "frictionloss", "1.5", "1.9"),
        ("slide", "armature", "0.3", "0.25"),
    ]
    assert [row["unit"] for row in table] == ["N m", "kg"]


@pytest.mark.parametrize("joint", [2, 3, 4])
def test_mass_behind_a_joint_is_that_of_the_robot(joint, nominal, tmp_path):
    """Of bodies with an <inertial>, with shapes only, and with an anchor off their origin."""
    extra = np.array([0.4, 0.02, -0.01, 0.03, 0.004, 0.0, 0.005, 0.001, 0.0, 0.003])
    before = nominal.tree.bodies[joint - 1].inertial_parameters
    robot = nominal.with_inertial_parameters(joint, before + extra)
    assert robot.tree.bodies[joint - 1].mass == pytest.approx(before[0] + 0.4)
    again, _, remarks = written(diagnosed(nominal, robot), tmp_path / "out")
    assert remarks == ()
    for own, wanted in zip(again.tree.bodies, robot.tree.bodies, strict=True):
        np.testing.assert_allclose(
            own.inertial_parameters, wanted.inertial_parameters, rtol=1e-6, atol=1e-7
        )


def test_joint_zero_moves_reference_stops_and_spring(nominal, tmp_path):
    zeros = np.array([0.02, 0.0, 0.001, 0.0])
    again, table, _ = written(diagnosed(nominal, zeros=zeros), tmp_path / "out")
    rng = np.random.default_rng(2)
    q, v, a = rng.uniform(-1.0, 1.0, (3, 4))
    np.testing.assert_allclose(
        again.rigid_bodies().torque(q, v, a),
        nominal.rigid_bodies().torque(q + zeros, v, a),
        rtol=1e-6,
    )
    limited = slice(0, 3)
    assert again.position_lower[limited] == pytest.approx((nominal.position_lower - zeros)[limited])
    assert read_mjcf(again.urdf).joints["slide"].spring_reference == pytest.approx(0.099)
    assert {row["attribute"] for row in table} == {"ref", "range", "springref"}
    assert {row["unit"] for row in table} == {"deg", "m"}


def test_drives_give_the_actual_torque(nominal, tmp_path):
    again, _, _ = written(diagnosed(nominal, gain=(0.9, 1.1, 1.0, 1.0)), tmp_path / "out")
    before, after = (
        {each.joint: each for each in read_mjcf(robot.urdf).actuators} for robot in (nominal, again)
    )
    assert after["pan"].position_gain == pytest.approx(0.9 * before["pan"].position_gain)
    assert after["pan"].velocity_gain == pytest.approx(0.9 * before["pan"].velocity_gain)
    assert after["pan"].torque_max == pytest.approx(0.9 * before["pan"].torque_max)
    assert after["lift"].gear == pytest.approx(11.0)


def test_gains_of_a_servo_are_those_estimated(nominal, tmp_path):
    found = diagnosed(nominal, stiffness=(180.0, *UNKNOWN[1:]), damping=(7.0, *UNKNOWN[1:]))
    again, table, _ = written(found, tmp_path / "out")
    servo = next(each for each in read_mjcf(again.urdf).actuators if each.joint == "pan")
    assert (servo.position_gain, servo.velocity_gain) == pytest.approx((180.0, 7.0))
    # At a gear of 2 the file's gains are a quarter of those at the joint.
    assert [(row["attribute"], row["old"], row["new"]) for row in table] == [
        ("kp", "50", "45"),
        ("kv", "2", "1.75"),
    ]


def test_velocity_gain_replaces_a_damping_ratio(tmp_path):
    path = write_arm(tmp_path)
    path.write_text(path.read_text().replace('kp="50" kv="2"', 'kp="50" dampratio="1"'))
    nominal = load(path)
    found = diagnosed(nominal, stiffness=(180.0, *UNKNOWN[1:]), damping=(7.0, *UNKNOWN[1:]))
    again, _, _ = written(found, tmp_path / "out")
    servo = next(each for each in read_mjcf(again.urdf).actuators if each.joint == "pan")
    assert (servo.position_gain, servo.velocity_gain) == pytest.approx((180.0, 7.0))


def test_what_the_file_cannot_take_is_said(nominal, tmp_path):
    less = nominal.tree.bodies[0].inertial_parameters + np.array([0.1, *([0.0] * 9)])
    robot = nominal.with_inertial_parameters(1, less)
    _, table, remarks = written(diagnosed(nominal, robot), tmp_path / "out")
    assert table == []
    assert "body 'shoulder'" in remarks[0]
    assert "several joints move it" in remarks[0]


def test_isaac_table_has_joint_values_in_its_own_units(nominal):
    friction = nominal.coulomb.copy()
    friction[0] = 1.9
    found = diagnosed(nominal, replace(nominal, coulomb=friction), gain=(0.9, 1.0, 1.0, 1.0))
    files = MODEL_FORMATS["usd"].export(found).files
    rows = list(csv.DictReader(str(files["isaac_joints.csv"]).splitlines()))
    pan = {row["isaac_lab"]: row for row in rows if row["joint"] == "pan"}
    assert (pan["friction"]["nominal"], pan["friction"]["found"]) == ("1.5", "1.9")
    assert (
        pan["dynamic_friction"]["usd_attribute"] == "physxJointAxis:angular:dynamicFrictionEffort"
    )
    assert float(pan["stiffness"]["found"]) == pytest.approx(180.0)
    assert float(pan["stiffness"]["usd_value"]) == pytest.approx(np.pi)
    assert pan["stiffness"]["usd_unit"] == "N m/deg"
    slide = {row["isaac_lab"]: row for row in rows if row["joint"] == "slide"}
    assert (slide["armature"]["usd_value"], slide["armature"]["usd_unit"]) == ("0.3", "kg")
    assert slide["viscous_friction"]["usd_value"] == "0.5"
    assert "stiffness" not in slide


def test_urdf_of_an_mjcf_is_the_same_robot(nominal, tmp_path):
    friction = nominal.coulomb.copy()
    friction[0] = 1.9
    robot = replace(nominal, coulomb=friction)
    path = tmp_path / "found.urdf"
    path.write_text(str(MODEL_FORMATS["urdf"].export(diagnosed(nominal, robot)).files[path.name]))
    again = load_robot(path)
    assert again.coulomb == pytest.approx(friction)
    assert again.rotor_inertia == pytest.approx(robot.rotor_inertia)
    q, v, a = np.random.default_rng(4).uniform(-1.0, 1.0, (3, 4))
    np.testing.assert_allclose(
        again.rigid_bodies().torque(q, v, a), robot.rigid_bodies().torque(q, v, a), rtol=1e-12
    )
