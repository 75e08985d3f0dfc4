"""MJCFs as robots: joints, masses and limits equal those of MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

from stiffopt.errors import InputError
from stiffopt.robot.files import load_robot
from stiffopt.robot.mjcf import read_mjcf
from stiffopt.robot.urdf import load_urdf

mujoco = pytest.importorskip("mujoco")

# Degrees, extrinsic Euler angles, nested defaults, a frame, an include, masses by shapes, two
# joints of one body, anchors off the body's origin, a reference, a mesh that is not there.
ARM = """<mujoco model="odd">
  <compiler angle="degree" eulerseq="XYZ" autolimits="true" meshdir="nowhere"/>
  <include file="parts/defaults.xml"/>
  <asset><mesh name="shell" file="shell.stl"/></asset>
  <worldbody>
    <body name="base" pos="0.1 0 0.2" euler="20 30 -40">
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <frame pos="0 0.05 0.1" euler="0 90 15">
        <body name="shoulder" childclass="big">
          <inertial pos="0.02 0.01 0.1" mass="2.5"
            fullinertia="0.02 0.03 0.025 0.001 -0.002 0.003"/>
          <geom type="mesh" mesh="shell"/>
          <joint name="pan" axis="0 1 1" range="-100 120" ref="25" pos="0.03 0 -0.02"/>
          <joint name="lift" axis="1 0 0" range="-90 90" pos="0 0.01 0.05" class="small"/>
          <body name="slider" pos="0 0.1 0.3" euler="10 0 80">
            <geom type="capsule" size="0.04 0.1" pos="0.05 0 0" density="900"/>
            <joint name="slide" type="slide" axis="0 0 -1" range="-0.1 0.2" ref="0.03"/>
            <body name="hand" pos="0 0 0.2" euler="0 90 0">
              <geom type="box" size="0.03 0.05 0.02" mass="0.7" pos="0.01 0.02 0.03"/>
              <joint name="roll" axis="0 0 1"/>
              <site name="tcp" pos="0 0 0.1" euler="0 0 30"/>
            </body>
          </body>
        </body>
      </frame>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="pan" kp="50" kv="2" gear="2" forcerange="-30 30"/>
    <motor name="drive" joint="lift" gear="10" ctrlrange="-4 4"/>
  </actuator>
</mujoco>
"""
DEFAULTS = """<mujocoinclude>
  <default>
    <joint damping="0.5"/>
    <default class="big"><joint armature="0.3" frictionloss="1.5"/>
      <default class="small"><joint armature="0.1" frictionloss="0.4"/></default>
    </default>
  </default>
</mujocoinclude>
"""


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "defaults.xml").write_text(DEFAULTS)
    (tmp_path / "odd.xml").write_text(ARM)
    return tmp_path / "odd.xml"


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


LEGS = """<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 0.5">
      <freejoint name="floating"/>
      <geom type="box" size="0.2 0.1 0.05" mass="6"/>
      {legs}
    </body>
    <body name="ball"><freejoint/><geom size="0.1" mass="0.2"/></body>
  </worldbody>
</mujoco>
"""
LEG = """<body name="hip_{k}" pos="0.2 {y} 0"><joint name="hip_{k}" axis="1 0 0"/>
  <geom size="0.04" mass="0.6"/>
  <body name="thigh_{k}" pos="0 0.05 0"><joint name="thigh_{k}" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.03" mass="1"/>
    <body name="calf_{k}" pos="0 0 -0.2"><joint name="calf_{k}" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.2"/></body></body></body>"""


@pytest.fixture
def legs(tmp_path):
    both = "".join(LEG.format(k=k, y=y) for k, y in (("l", 0.1), ("r", -0.1)))
    (tmp_path / "legs.xml").write_text(LEGS.format(legs=both))
    return tmp_path / "legs.xml"


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
        ('<mujoco><include file="away.xml"/></mujoco>', "away.xml"),
    ],
)
def test_refused_files_are_named(text, said, tmp_path):
    (tmp_path / "arm.xml").write_text(text)
    with pytest.raises(InputError, match=f"arm.xml: .*{said}"):
        load_robot(tmp_path / "arm.xml")


def test_missing_package_is_named(legs, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'stiffopt\[mjcf\]'"):
        load_urdf(legs)
