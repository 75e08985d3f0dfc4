"""URDFs that branch: an arm with fingers, beside wheels or a head; legs, and several arms."""

from __future__ import annotations

import re

import pytest
from small_urdfs import chain, joint, written

from stiffopt.cli import run
from stiffopt.errors import RobotError
from stiffopt.robot.files import load_robot

WHEEL = '<limit effort="5" velocity="10"/>'
JAW = '<limit lower="0" upper="0.04" effort="20" velocity="0.2"/>'


def wheels(count=4):
    return "".join(
        joint(f"wheel_{k}", "base", f"wheel_{k}_link", WHEEL, kind="continuous")
        for k in range(count)
    )


def jaws(link, *names):
    return "".join(joint(name, link, f"{name}_link", JAW, kind="prismatic") for name in names)


@pytest.mark.parametrize(
    ("parts", "said", "tips"),
    [
        (
            [chain(3, prefix=leg) for leg in ("fl_", "fr_", "rl_", "rr_")],
            "branches into 4 chains of 3 joints",
            ["fl_link3", "fr_link3", "rl_link3", "rr_link3"],
        ),
        ([wheels()], "4 chains of 1 joint,", [f"wheel_{k}_link" for k in range(4)]),
        ([wheels(2), chain(6, prefix="l_"), chain(6, prefix="r_")], "4 chains of 1 to 6 joints",
         ["l_link6", "r_link6", "wheel_0_link", "wheel_1_link"]),
        # A torso of a humanoid, whose arms have hands.
        (
            [chain(2), *(chain(6, prefix=arm, base="link2") for arm in ("l_", "r_")),
             jaws("l_link6", "a", "b", "c"), jaws("r_link6", "gripper"), chain(6, prefix="leg_")],
            "3 chains of 6 to 8 joints", ["l_link6", "r_link6", "leg_link6"],
        ),
        # Two fingers that are not called so: they, or the arm before them.
        ([chain(2), jaws("link2", "x", "y")], "3 chains of 2 to 3 joints",
         ["link2", "x_link", "y_link"]),
    ],
)  # fmt: skip
def test_ambiguous_branch_has_to_be_named(parts, said, tips, tmp_path, capsys):
    """Whoever reads the URDF, as a robot or for a robot file; no order of joints makes an arm."""
    urdf = written(tmp_path, *parts)
    assert run(["init", "robot", str(urdf)]) == 2
    message = capsys.readouterr().err
    assert said in message
    assert " or ".join(f'--tip "{tip}"' for tip in tips) in message
    for command in (["stiffness"], ["modes", "--at", "0"]):
        assert run([command[0], str(urdf), *command[1:]]) == 2
        assert said in capsys.readouterr().err
    with pytest.raises(RobotError, match=re.escape(said)):
        load_robot(urdf)
    assert run(["init", "robot", str(urdf), "--tip", tips[0]]) == 0
    out = capsys.readouterr().out
    arm = load_robot(tmp_path / "arm_robot.toml")
    assert arm.tool.link == tips[0]
    assert all(h.name in out for h in arm.held)
    assert [body.parent for body in arm.tree.bodies] == list(range(arm.n))  # one chain


def test_an_arm_beside_wheels_is_the_arm(tmp_path, capsys):
    """Also a short one; a head and wheels are held, which is said."""
    urdf = written(tmp_path, wheels(), chain(4), jaws("link4", "left", "right"))
    assert run(["init", "robot", str(urdf)]) == 0
    out = capsys.readouterr().out
    assert "The arm: 1, 2, 3, 4;" in out
    (held,) = (
        line for line in out.splitlines() if "Held at 0 (not on the way to the tool): " in line
    )
    for name in ("wheel_0", "wheel_3", "left", "right"):
        assert name in held


def test_fingers_of_an_arm_of_two_joints(tmp_path):
    arm = load_robot(written(tmp_path, chain(2), jaws("link2", "finger_1", "finger_2")))
    assert arm.joint_names == ("1", "2")


def test_a_chain_whose_joints_a_file_describes_is_the_arm(tmp_path):
    """Or one that is left where all others are held; a tool that there is not is named."""
    urdf = written(tmp_path, chain(3, prefix="l_"), chain(3, prefix="r_"))
    head = f'schema = 1\nkind = "robot"\nname = "a"\nurdf = "{urdf.name}"\n'
    file = tmp_path / "robot.toml"
    file.write_text(head + '[[joint]]\nname = "r_2"\n')
    assert load_robot(file).joint_names == ("r_1", "r_2", "r_3")
    file.write_text(head + "lock = { l_1 = 0.0, l_2 = 0.1, l_3 = 0.0 }\n")
    assert load_robot(file).joint_names == ("r_1", "r_2", "r_3")
    file.write_text(head + "".join(f'[[joint]]\nname = "{s}_{k}"\n' for s in "lr" for k in (1, 2)))
    assert load_robot(file).n == 6
    file.write_text(head + '[tool]\nlink = "r_link33"\n')
    with pytest.raises(RobotError, match=r"no link 'r_link33'\. Did you mean 'r_link3'"):
        load_robot(file)
