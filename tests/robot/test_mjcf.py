"""MJCFs as robots: joints, masses and limits equal those of MuJoCo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mjcf_models import LEG, write_arm, write_legs

from stiffopt.errors import InputError
from stiffopt.robot.files import load_robot
from stiffopt.robot.mjcf import mjcf_parts, read_mjcf
from stiffopt.robot.urdf import load_urdf

mujoco = pytest.importorskip("mujoco")


@pytest.fixture
def arm(tmp_path):
    return write_arm(tmp_path)


def robot_of(path, names=("pan", "lift", "slide", "roll"), entries="", tip="tcp"):
    text = f'schema = 1\nkind = "robot"\nname = "odd"\nurdf = "{path.name}"\n{entries}\n'
    text += f'tool = {{ link = "{tip}" }}\n' if tip else ""
    for name in names:
        text += f'[[joint]]\nname = "{name}"\ntorque_max = 50.0\nvelocity_max = 2.0\n'
    file = path.with_name("robot.toml")
    file.write_text(text)
    return load_robot(file)


def compiled(path):
    """MuJoCo's own model, without meshes and constraints."""
    spec = mujoco.MjSpec.from_file(str(path))
    for geom in [each for each in spec.geoms if each.meshname]:
        spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    model = spec.compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return model


def test_inverse_dynamics_and_tool_equal_those_of_mujoco(arm):
    robot, model = robot_of(arm), compiled(arm)
    data, bodies = mujoco.MjData(model), robot.rigid_bodies()
    assert robot.joint_names == ("pan", "lift", "slide", "roll")
    rng = np.random.default_rng(5)
    for _ in range(20):
        q, v, a = rng.uniform(-3.0, 3.0, (3, 4))
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        torque = data.qfrc_inverse + data.qfrc_passive
        own = bodies.torque(q, v, a) + robot.rotor_inertia * a
        np.testing.assert_allclose(own, torque, atol=1e-9 * np.abs(torque).max())
        place, turn = bodies.pose(robot.tool, q)
        np.testing.assert_allclose(place, data.site("tcp").xpos, atol=1e-12)
        np.testing.assert_allclose(turn.ravel(), data.site("tcp").xmat, atol=1e-12)


def test_joint_values_come_from_classes_and_actuators(arm):
    robot = robot_of(arm)
    assert robot.rotor_inertia == pytest.approx([0.3, 0.1, 0.3, 0.3])
    assert robot.coulomb == pytest.approx([1.5, 0.4, 1.5, 1.5])
    assert robot.viscous == pytest.approx([0.5] * 4)
    assert np.rad2deg(robot.position_lower[:2]) == pytest.approx([-100.0, -90.0])
    assert robot.position_upper[2] == pytest.approx(0.2)
    assert robot.position_upper[3] == np.inf
    servo, drive = read_mjcf(arm).actuators
    assert (servo.joint, servo.position_gain, servo.velocity_gain) == ("pan", 200.0, 8.0)
    assert (servo.torque_max, drive.torque_max) == (60.0, 40.0)
    stated = load_urdf(arm, tip="tcp", limited=None).joints
    assert [stated[name]["effort"] for name in ("pan", "lift", "slide")] == [60.0, 40.0, 0.0]


@pytest.fixture
def legs(tmp_path):
    return write_legs(tmp_path)


def test_free_base_is_refused_until_it_is_locked(legs):
    names = ("hip_l", "thigh_l", "calf_l")
    with pytest.raises(InputError, match=r"'floating' is of the kind 'free'.*lock = { floating"):
        robot_of(legs, names, tip="calf_l")
    robot = robot_of(legs, names, "lock = { floating = 0.0 }", tip="calf_l")
    assert robot.joint_names == names
    # The leg hangs from the base at 0.5 m.
    tool, _ = robot.rigid_bodies().pose(robot.tool, np.zeros(3))
    assert tool == pytest.approx([0.2, 0.15, 0.3])
    assert {held.name for held in robot.held} >= {"floating", "hip_r", "ball_joint"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<mujoco><worldbody><body/></worldbody><oops/></mujoco>", "is refused by MuJoCo: .*oops"),
        ("<mujoco><worldbody/></mujoco>", "no joint moves"),
        ('<mujoco><include file="away.xml"/></mujoco>', "include: there is no file .*away.xml"),
        (
            '<mujoco><asset><mesh name="m" file="m.stl"/></asset><worldbody><body name="b">'
            '<joint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
            "body 'b': takes its mass from .*m.stl, which is not there. Copy",
        ),
    ],
)
def test_refused_files_are_named(text, said, tmp_path):
    (tmp_path / "arm.xml").write_text(text)
    with pytest.raises(InputError, match=f"arm.xml(:|,) .*{said}"):
        load_robot(tmp_path / "arm.xml")


def test_missing_package_is_named(legs, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'stiffopt\[mjcf\]'"):
        load_urdf(legs)


def test_warnings_of_mujoco_are_notes_and_leave_no_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    body = '<body name="b"><joint name="j"/><geom size="0.1"/></body>'
    Path("part.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    Path("robot.xml").write_text(
        '<mujoco><asset><model name="part" file="part.xml"/></asset>'
        '<worldbody><attach model="part" prefix=""/></worldbody></mujoco>'
    )
    notes = read_mjcf("robot.xml").notes
    if not notes:
        pytest.skip("this version of MuJoCo does not warn of it")
    assert notes[0].startswith("MuJoCo: Attaching a spec with an empty prefix")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["part.xml", "robot.xml"]


def test_attached_models_are_parts(tmp_path):
    leg = LEG.format(k="l", y=0.1)
    (tmp_path / "leg.xml").write_text(f'<mujoco model="leg"><worldbody>{leg}</worldbody></mujoco>')
    (tmp_path / "robot.xml").write_text(
        '<mujoco><asset><model name="leg" file="leg.xml"/></asset><worldbody><body name="stand">'
        '<attach model="leg" body="hip_l" prefix="front_"/></body></worldbody></mujoco>'
    )
    assert [part.name for part in mjcf_parts(tmp_path / "robot.xml")] == ["robot.xml", "leg.xml"]
    assert load_robot(tmp_path / "robot.xml").joint_names == (
        "front_hip_l",
        "front_thigh_l",
        "front_calf_l",
    )
