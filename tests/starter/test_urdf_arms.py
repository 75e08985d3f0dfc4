"""URDFs as they are found: several arms, followers, xacro, bodies without extent."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from gripper_arm import write_gripper_urdf
from small_arms import joint as table_of
from small_arms import write_robot
from small_urdfs import LIMIT, MASS, chain, changed, joint, written

from stiffopt.cli import run
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.errors import InputError, NotSimulatedError, RobotError
from stiffopt.problem.files import load_problem
from stiffopt.problem.input_checks import check_clear_poses
from stiffopt.problem.resolve import resolve
from stiffopt.robot.cell import Cell
from stiffopt.robot.clearance import ClearanceModel
from stiffopt.robot.files import load_robot
from stiffopt.starter.problem_file import first_motion


def test_tool_of_an_arm_with_flange_and_tool0_has_the_axes_of_the_controller(tmp_path):
    """As ROS-Industrial names them: x is outward at the flange, z at tool0."""
    turned = '<origin rpy="0 1.5707963 0"/>'
    flange = joint(
        "mount", "link6", "flange", kind="fixed", origin="0 0 0.1", inside="", axis="1 0 0"
    )
    tool = '<link name="tool0"/><joint name="turn" type="fixed"><parent link="flange"/>' + (
        f'<child link="tool0"/>{turned}</joint>'
    )
    arm = load_robot(written(tmp_path, chain(6), flange, tool))
    assert (arm.tool.link, arm.flange.link) == ("tool0", "tool0")
    np.testing.assert_allclose(arm.tool.rotation[:, 2], [1.0, 0.0, 0.0], atol=1e-6)


def test_mimic_cylinder_is_not_a_branch(tmp_path):
    """As of the counterbalance of an industrial arm."""
    follows = LIMIT + '<mimic joint="2" multiplier="-0.25"/>'
    urdf = written(tmp_path, chain(6), joint("cylinder", "link1", "cylinder_link", follows))
    arm = load_robot(urdf)
    assert arm.joint_names == tuple("123456")
    assert [(h.name, h.why) for h in arm.held] == [("cylinder", "follows 2, which moves")]


def test_mimic_jaws_are_a_gripper(tmp_path):
    follows = LIMIT + '<mimic joint="left_knuckle"/>'
    urdf = written(
        tmp_path,
        chain(6),
        joint("left_knuckle", "link6", "left"),
        joint("right_knuckle", "link6", "right", follows),
    )
    assert load_robot(urdf).joint_names == tuple("123456")


def test_joint_named_gripper_is_not_an_axis(tmp_path):
    urdf = written(tmp_path, chain(5), joint("Gripper", "link5", "jaw"))
    assert load_robot(urdf).joint_names == tuple("12345")
    head = f'schema = 1\nkind = "robot"\nname = "a"\nurdf = "{urdf.name}"\n'
    (tmp_path / "robot.toml").write_text(head + '[[joint]]\nname = "Gripper"\n')
    assert load_robot(tmp_path / "robot.toml").joint_names == (*"12345", "Gripper")


def test_a_head_beside_the_arm_is_held(tmp_path):
    arm = load_robot(written(tmp_path, joint("head", "base", "head_link"), chain(6)))
    assert arm.joint_names == tuple("123456")
    assert [h.name for h in arm.held] == ["head"]


def test_of_two_arms_one_has_to_be_named(tmp_path, capsys):
    urdf = written(tmp_path, chain(6, prefix="left_"), chain(6, prefix="right_"))
    assert run(["init", "robot", str(urdf)]) == 2
    assert '--tip "left_link6" or --tip "right_link6"' in capsys.readouterr().err
    assert run(["init", "robot", str(urdf), "--tip", "right_link6"]) == 0
    arm = load_robot(tmp_path / "arm_robot.toml")
    assert arm.joint_names == tuple(f"right_{k}" for k in range(1, 7))


def test_mimic_joint_on_the_path_is_held_and_reported(tmp_path, capsys):
    """As in a hollow wrist; the message that names `init robot` is not met again there."""
    urdf = written(tmp_path, chain(6))
    axis = '<child link="link5"/>'
    urdf.write_text(urdf.read_text().replace(axis, axis + '<mimic joint="4"/>'))
    with pytest.raises(RobotError, match="'5' follows '4'"):
        load_robot(urdf)
    assert run(["init", "robot", str(urdf)]) == 0
    assert "from the real one" in capsys.readouterr().out
    assert load_robot(tmp_path / "arm_robot.toml").joint_names == tuple("12346")


def test_rigid_strongest_joint_gets_least_heat_objective(tmp_path, capsys):
    spring = '[[joint.element]]\nname = "spring"\ntype = "constant"\nstiffness = 1e4\n'
    elastic = [table_of("shoulder", spring), table_of("elbow", spring, torque_max=30.0)]
    bare = [table_of("shoulder", ""), table_of("elbow", spring, torque_max=30.0)]
    for joints, objective in ((elastic, "tool_error"), (bare, "torque_squared")):
        robot = write_robot(tmp_path, "planar", joints)
        out = tmp_path / f"{objective}.toml"
        assert run(["init", "problem", str(robot), "--out", str(out)]) == 0
        assert load_problem(out).problem.objectives[0].name == objective
    assert "shoulder, the strongest," in out.read_text()


def test_a_spring_without_inertia_is_named(tmp_path):
    urdf = written(tmp_path, chain(3))
    urdf.write_text(urdf.read_text().replace(MASS, "@", 2).replace(MASS, "").replace("@", MASS))
    element = '[[joint.element]]\nname = "spring"\ntype = "constant"\nstiffness = 1e4\n'
    sections = "".join(f'[[joint]]\nname = "{k}"\n{element}' for k in "123")
    head = 'schema = 1\nkind = "robot"\nname = "arm"\nurdf = "arm.urdf"\n'
    (tmp_path / "robot.toml").write_text(head + sections)
    arm = load_robot(tmp_path / "robot.toml")
    with pytest.raises(NotSimulatedError, match="behind 3 have no inertia"):
        modes(ElasticArm(arm, np.zeros(3)), np.zeros(3))


def test_shapes_without_extent_are_left_out(tmp_path):
    nothing = '<visual><geometry><box size="0 0 0"/></geometry></visual>'
    urdf = written(tmp_path, chain(3, mass=MASS + nothing))
    assert load_robot(urdf).shapes == ()
    urdf.write_text(urdf.read_text().replace("0 0 0", "1 1 -1"))
    with pytest.raises(RobotError, match="allowed is 0 or above"):
        load_robot(urdf)


def test_first_problem_has_time_for_vibration(tmp_path):
    """The seven axes with a hand: within the joints' limits."""
    urdf = write_gripper_urdf(tmp_path)
    assert run(["init", "robot", str(urdf)]) == 0
    assert run(["init", "problem", str(tmp_path / "seven_robot.toml")]) == 0
    problem = load_problem(tmp_path / "seven_first.toml").problem
    assert problem.objectives[0].name == "tool_error"
    pose = resolve(problem).start
    lowest = modes(ElasticArm(problem.robot, pose), pose)[0].frequency
    assert problem.duration[0] > 2.0 / lowest + 0.2


def test_a_drive_that_cannot_hold_its_link_is_named(tmp_path, capsys):
    weak = '<limit lower="-2" upper="2" effort="0.5" velocity="2"/>'
    urdf = written(tmp_path, chain(3, inside=weak))
    assert run(["init", "problem", str(urdf)]) == 2
    assert re.search(
        r"do its drives hold its weight: \d has 0.5 N m and needs", capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('effort="80"', 'effort="${most}"', "holds xacro that is not expanded, such as '${most}'"),
        (' iyz="0"', "", "its <inertial> lacks iyz"),
        ('<mass value="3"/>', "", "its <inertial> lacks <mass>"),
        ('effort="80"', 'effort="-80"', "'1', limit effort = -80 is below 0"),
        ('xyz="0 0 0.3"', 'xyz="0 0 300"', "lies 300 m from the one before.*exported in mm"),
    ],
)
def test_invalid_urdf_is_reported(old, new, said, tmp_path):
    urdf = written(tmp_path, chain(3))
    urdf.write_text(urdf.read_text().replace(old, new))
    pattern = said if ".*" in said else re.escape(said)
    with pytest.raises(InputError, match=pattern):
        load_robot(urdf)


def test_a_file_of_macros_alone_is_xacro(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text('<robot name="a" xmlns:xacro="http://ros.org/xacro"><xacro:arm/></robot>')
    with pytest.raises(InputError, match=r"such as <xacro:arm>\. Expand it first"):
        load_robot(urdf)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("</robot>", '<xacro:gripper parent="2"/></robot>', "such as <xacro:gripper>"),
        ("</robot>", '<xacro:include filename="hand.xacro"/></robot>', "such as <xacro:include>"),
        (MASS, "<xacro:cylinder_inertia/>", "such as <xacro:cylinder_inertia>"),
    ],
)
def test_a_call_of_a_macro_that_is_left_over_is_no_arm(old, new, said, tmp_path):
    with pytest.raises(InputError, match=f"not expanded, {said}"):
        load_robot(changed(tmp_path, [(old, new)]))


def test_definitions_of_xacro_that_are_left_over_change_nothing(tmp_path):
    left = (
        '<xacro:property name="m" value="2"/><xacro:macro name="a"><link name="x"/></xacro:macro>'
    )
    assert load_robot(changed(tmp_path, [("</robot>", left + "</robot>")])).n == 3


def test_frames_with_small_mass_are_accepted(tmp_path):
    """A tool's frame, and a base of the world that carries the arm but never moves."""
    tiny = '<mass value="1e-9"/><inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/>'
    heavy = '<mass value="1e-4"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    frames = (
        f'<link name="tcp"><inertial>{tiny}</inertial></link><joint name="to_tcp" type="fixed">'
        '<parent link="link3"/><child link="tcp"/></joint>'
        f'<link name="stand"><inertial>{heavy}</inertial></link><joint name="to_stand"'
        ' type="fixed"><parent link="base"/><child link="stand"/></joint>'
    )
    assert load_robot(changed(tmp_path, [("</robot>", frames + "</robot>")])).n == 3
    # The second one would slow the arm down where it moves.
    moved = frames.replace('parent link="base"', 'parent link="link1"')
    with pytest.raises(InputError, match=r"'stand': 0.0001 kg with 1 kg m\^2 lie 100 m from"):
        load_robot(changed(tmp_path, [("</robot>", moved + "</robot>")]))


def test_a_joint_that_follows_itself_is_named(tmp_path):
    follows = '<mimic joint="1"/></joint>'
    with pytest.raises(InputError, match="'1' follows itself"):
        load_robot(changed(tmp_path, [("</joint>", follows)]))


def test_links_fixed_farther_out_are_offered_as_tools(tmp_path, capsys):
    tcp = joint("mount", "link3", "my tcp", "", "fixed", origin="0 0 0.17")
    urdf = written(tmp_path, chain(3), tcp)
    assert run(["init", "robot", str(urdf)]) == 0
    assert "tcp (170 mm away)" in (said := capsys.readouterr().out)
    assert "--tip 'my tcp'" in said
    (tmp_path / "arm_robot.toml").unlink()
    assert run(["init", "robot", str(urdf), "--tip", "my tcp"]) == 0
    assert "Fixed to" not in capsys.readouterr().out


def test_a_tool_behind_a_held_joint_is_not_too_far_out(tmp_path):
    """The link of a joint that follows another one is longer than the arm before it."""
    follows = LIMIT + '<mimic joint="2" multiplier="-1"/>'
    long = joint("3", "link2", "link3", follows, origin="0 0 1.5")
    urdf = written(tmp_path, chain(2), long)
    assert run(["init", "robot", str(urdf), "--tip", "link3"]) == 0
    assert run(["init", "problem", str(tmp_path / "arm_robot.toml")]) == 0
    resolve(load_problem(tmp_path / "arm_first.toml").problem)


BAR = '<collision><origin xyz="0 0 0.3"/><geometry><box size="0.1 0.1 0.6"/></geometry></collision>'


def folded(folder, effort=80.0, velocity=2.0):
    """Three links with shapes; about the middle of its range the third lies on the first."""
    body = MASS.replace("</inertial>", "</inertial>" + BAR)
    limits = {"b": (-0.3, 0.3), "c": (1.3, 4.9), "a": (-2.0, 2.0)}
    parts, parent = "", "base"
    for name, axis in (("a", "0 0 1"), ("b", "0 1 0"), ("c", "0 1 0")):
        low, high = limits[name]
        inside = f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{velocity}"/>'
        one = joint(name, parent, f"link_{name}", inside, axis=axis, origin="0 0 0.4")
        parts, parent = parts + one.replace(MASS, body), f"link_{name}"
    return written(folder, parts)


def test_first_problem_avoids_collisions_between_links(tmp_path, capsys):
    urdf = folded(tmp_path)
    arm = load_robot(urdf)
    shapes = ClearanceModel(arm, Cell())
    middle = 0.5 * (arm.position_lower + arm.position_upper)
    assert shapes.distances(middle).min() < 0.0
    assert run(["init", "problem", str(urdf), "-o", str(tmp_path / "p.toml")]) == 0
    problem = load_problem(tmp_path / "p.toml").problem
    motion = resolve(problem)
    check_clear_poses(problem, motion)
    for share in (0.0, 0.3, 0.7, 1.0):
        pose = motion.start + share * (motion.end - motion.start)
        assert shapes.distances(pose).min() > 0.0


def test_first_problem_slows_down_for_weak_drives(tmp_path):
    """Their torque, not speed or acceleration, decides how long the motion takes."""
    durations = []
    for effort in (200.0, 7.0):
        folder = tmp_path / f"{effort:g}"
        folder.mkdir()
        urdf = folded(folder, effort, 20.0)
        assert run(["init", "problem", str(urdf), "-o", str(folder / "p.toml")]) == 0
        problem = load_problem(folder / "p.toml").problem
        durations.append(problem.duration[1])
        motion = resolve(problem)
        s = np.linspace(0.0, 1.0, 101)
        law = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        way = motion.end - motion.start
        q = motion.start + law[:, None] * way
        rate = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / durations[-1] ** 2
        speed = 30.0 * s**2 * (1.0 - s) ** 2 / durations[-1]
        bodies = problem.robot.rigid_bodies()
        most = max(
            np.abs(bodies.torque(q[k], speed[k] * way, rate[k] * way)).max() for k in range(101)
        )
        assert most < 0.85 * effort
    assert durations[1] > durations[0]


def test_friction_counts_where_drives_hold_an_arm():
    """Friction of a quarter of the torque leaves poses in which the arm moves as fast."""
    arm = load_robot("ur10")
    rubbing = first_motion(replace(arm, coulomb=0.25 * arm.torque_max))
    assert rubbing.duration < 2.0 * first_motion(arm).duration
    with pytest.raises(RobotError, match="hold its weight and Coulomb friction: j3 has 90 N m"):
        first_motion(replace(arm, coulomb=0.95 * arm.torque_max))


def heavy_bar(folder):
    """One joint that turns by 0.3 rad about the horizontal: 3.9 N m of 6."""
    mass = MASS.replace('xyz="0 0 0.1"', 'xyz="0.1325 0 0"')
    inside = '<limit lower="-0.3" upper="0.3" effort="6" velocity="2"/>'
    return load_robot(written(folder, joint("a", "base", "bar", inside).replace(MASS, mass)))


def test_slowing_stops_where_it_no_longer_helps(tmp_path):
    """With 81 % for weight and friction the motion takes seconds and keeps some of the torque."""
    arm = replace(heavy_bar(tmp_path), coulomb=np.array([0.95]))
    motion = first_motion(arm)
    assert motion.duration < 3.0
    middle = 0.5 * (motion.start + motion.end)
    assert 0.8 < (abs(arm.rigid_bodies().gravity_torque(middle)[0]) + 0.95) / 6.0 < 0.82


def test_motion_infeasible_at_any_duration_is_refused(tmp_path):
    with pytest.raises(
        RobotError, match=r"motion of [\d.]+ s still takes \d+ % of the torque of a"
    ):
        first_motion(replace(heavy_bar(tmp_path), viscous=np.array([1e5])))


def test_first_problem_reports_collision_checks(tmp_path):
    path = tmp_path / "p.toml"
    assert run(["init", "problem", "ur10", "-o", str(path)]) == 0
    assert (
        "collisions between links are not checked: their shapes are not known" in path.read_text()
    )
    path.unlink()
    assert run(["init", "problem", str(folded(tmp_path)), "-o", str(path)]) == 0
    assert "# collisions between links are checked;" in path.read_text()


def test_a_link_that_is_called_as_a_joint(tmp_path, capsys):
    """As of grippers whose fixed joint bears the name of its link."""
    urdf = written(tmp_path, chain(3), joint("hand", "link3", "hand", "", kind="fixed"))
    assert run(["init", "robot", str(urdf), "--out", str(tmp_path / "robot.toml")]) == 0
    assert "hand (300 mm away)" in capsys.readouterr().out


def test_joints_that_a_urdf_lists_from_the_tool_to_the_base(tmp_path, capsys):
    """Some exporters do: what a joint needs is its own, whatever the order."""
    weak = LIMIT.replace('"80"', '"0"')
    near = joint("near", "base", "a", weak)
    far = joint("far", "a", "b", weak.replace('velocity="2"', 'velocity="6"'))
    texts = []
    for order in ((near, far), (far, near)):
        folder = tmp_path / str(len(texts))
        folder.mkdir()
        assert run(["init", "robot", str(written(folder, *order))]) == 0
        assert "The arm: near, far;" in capsys.readouterr().out
        texts.append((folder / "arm_robot.toml").read_text())
    assert texts[0] == texts[1]


def test_recordings_of_one_of_two_arms(tmp_path, capsys):
    urdf = written(tmp_path, chain(6, prefix="left_"), chain(6, prefix="right_"))
    t = np.arange(0.0, 12.0, 0.02)
    head = ["t", *(f"{what}{k}" for what in ("q", "tau") for k in range(1, 7))]
    table = np.column_stack([t, *(np.sin(k * t) for k in range(1, 13))])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(head), comments="")
    arguments = ["init", "recording", str(tmp_path / "log.csv"), "--urdf", str(urdf)]
    assert run(arguments) == 2
    said = capsys.readouterr().err
    assert "for 12 joints" in said
    assert "2 chains of 6 joints" in said
    assert '--tip "left_link6" or --tip "right_link6" of `stiffopt init`' in said
    assert run([*arguments, "--tip", "right_link6"]) == 0
    text = (tmp_path / "log_set" / "recordings.toml").read_text()
    assert 'joints = ["right_1", "right_2", "right_3", "right_4", "right_5", "right_6"]' in text
    # Made-up torques belong to no motion.
    assert run(["recording", "check", str(tmp_path / "log_set")]) == 2
    assert "does not follow the motion" in capsys.readouterr().err
