"""The arm is the chain to its tip: locked joints, fingers and followers are held."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest
from gripper_arm import gripper_urdf, write_gripper_urdf

from stiffopt.errors import InputError, RobotError
from stiffopt.robot.files import load_robot
from stiffopt.robot.frames import named_frame

ARM = tuple(f"axis_{k}" for k in range(1, 8))
Q = np.array([0.3, -0.5, 0.2, -1.9, 0.4, 1.2, 0.7])
ROBOT = 'schema = 1\nkind = "robot"\nname = "seven"\nurdf = "seven.urdf"\n'


def robot(folder, text: str, follower: str = '<mimic joint="finger_1"/>'):
    write_gripper_urdf(folder, follower)
    path = folder / "robot.toml"
    path.write_text(ROBOT + text)
    return load_robot(path)


def test_fingers_are_no_joints_of_the_arm(tmp_path):
    arm = load_robot(write_gripper_urdf(tmp_path))
    assert arm.joint_names == ARM
    assert [(h.name, h.value, h.why) for h in arm.held] == [
        ("finger_1", 0.0, "not on the way to the tool"),
        ("finger_2", 0.0, "follows finger_1"),
    ]


def test_locked_joint_keeps_its_position(tmp_path):
    arm = robot(tmp_path, 'lock = { axis_3 = "30 deg", finger_1 = "20 mm" }\n')
    assert arm.joint_names == tuple(name for name in ARM if name != "axis_3")
    full = pin.buildModelFromXML(gripper_urdf(""))
    q = np.concatenate([Q[:2], [np.radians(30.0)], Q[3:], [0.02, 0.02]])
    data = full.createData()
    pin.framesForwardKinematics(full, data, q)
    for link in ("hand", "finger_link_1", "finger_link_2"):
        own, turn = arm.rigid_bodies().pose(named_frame(arm.model, link), np.delete(Q, 2))
        there = data.oMf[full.getFrameId(link)]
        assert own == pytest.approx(there.translation, abs=1e-12)
        assert turn == pytest.approx(there.rotation, abs=1e-12)
    gravity = pin.computeGeneralizedGravity(full, data, q)
    ours = arm.rigid_bodies().gravity_torque(np.delete(Q, 2))
    assert ours == pytest.approx(np.delete(gravity[:7], 2), abs=1e-10)


def test_joint_described_in_the_file_moves(tmp_path):
    text = '[[joint]]\nname = "finger_2"\n'
    arm = robot(tmp_path, text, follower="")
    assert arm.joint_names == (*ARM, "finger_2")


def test_joints_beyond_the_tool_are_held(tmp_path):
    arm = robot(tmp_path, '[tool]\nlink = "link_5"\n')
    assert arm.joint_names == ARM[:5]
    assert {h.name for h in arm.held} == {"axis_6", "axis_7", "finger_1", "finger_2"}


@pytest.mark.parametrize(
    ("text", "follower", "said"),
    [
        ("lock = { axis_8 = 0.0 }\n", "", "lock names no moving joint 'axis_8'. Did you mean"),
        ("lock = { axis_1 = 4.0 }\n", "", "axis_1 is held at 4, its limits are -2.9 to 2.9"),
        ('lock = { finger_1 = "3 deg" }\n', "", "lock.finger_1"),
        ('lock = { axis_7 = 0.0 }\n[[joint]]\nname = "axis_7"\n', "", "`lock` holds this joint"),
        ("", '<mimic joint="thumb"/>', "follows 'thumb' (mimic), which there is not"),
    ],
)
def test_held_joint_messages(tmp_path, text, follower, said):
    with pytest.raises(InputError, match=re.escape(said)):
        robot(tmp_path, text, follower)


def test_following_joint_of_the_arm_can_be_held(tmp_path):
    write_gripper_urdf(tmp_path)
    urdf = tmp_path / "seven.urdf"
    text = urdf.read_text().replace(
        '<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><mimic joint="axis_6"/>'
    )
    urdf.write_text(text)
    with pytest.raises(RobotError, match=r"lock = \{ axis_7 = 0.0 \}"):
        load_robot(urdf)
    (tmp_path / "robot.toml").write_text(ROBOT + "lock = { axis_7 = 0.0 }\n")
    assert load_robot(tmp_path / "robot.toml").joint_names == ARM[:6]
