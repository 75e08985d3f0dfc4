"""Process force along a path: frames, segments, feed, tables, and implausible forces."""

from dataclasses import replace

import numpy as np
import pytest

from stiffopt.command.command_lead import force_lead
from stiffopt.errors import InputError, ProblemError
from stiffopt.path.timed_path import timed_motion
from stiffopt.problem.files import load_problem
from stiffopt.problem.path_force import PathForce, ProcessDeflection, check_path_force
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.robot import Source

FRAMES = np.repeat(np.eye(3)[None], 2, axis=0)

PROBLEM = """schema = 1
kind = "trajectory"
robot = "er3a_c60"

[motion]
duration = {{ lower = "0.1 s" }}

[path]
start = {{ position = ["350 mm", "-50 mm", "250 mm"], rpy = ["180 deg", 0, 0] }}
speed = "100 mm/s"

[path.force]
{force}

[[path.segment]]
type = "lin"
to = {{ position = ["350 mm", "0 mm", "250 mm"] }}
{first}

[[path.segment]]
type = "lin"
to = {{ position = ["350 mm", "50 mm", "250 mm"] }}

[[minimise]]
objective = "duration"
"""


def load(tmp_path, force, first=""):
    path = tmp_path / "problem.toml"
    path.write_text(PROBLEM.format(force=force, first=first))
    return load_problem(path).problem


@pytest.mark.parametrize(
    ("frame", "wanted"),
    [
        ("base", [3.0, 4.0, 5.0]),
        # The tool is turned half about x; the feed is y of the base.
        ("tool", [3.0, -4.0, -5.0]),
        ("path", [4.0, 3.0, -5.0]),
    ],
)
def test_force_is_turned_from_its_frame(tmp_path, frame, wanted):
    force = load(tmp_path, f'value = [3.0, 4.0, 5.0]\nframe = "{frame}"').path_force
    np.testing.assert_allclose(force(np.array([0.1, 0.9])), [wanted, wanted], atol=1e-9)


def test_segments_have_forces_of_their_own_with_a_ramp_between(tmp_path):
    problem = load(tmp_path, 'value = [0.0, 0.0, 8.0]\nramp = "10 mm"', "force = [0.0, 0.0, 2.0]")
    s = np.array([0.1, 0.44, 0.5, 0.56, 0.9])
    np.testing.assert_allclose(problem.path_force(s)[:, 2], [2.0, 2.0, 5.0, 8.0, 8.0], atol=1e-6)


def test_force_follows_the_feed(tmp_path):
    problem = load(tmp_path, "per_feed = [200.0, 0.0, 0.0]")
    motion = timed_motion(problem)
    time = motion.assessment.time
    force = motion.trajectory.force(time)
    np.testing.assert_allclose(force[:, 0], 200.0 * motion.assessment.tool_speed, atol=0.05)
    assert force[:, 0].max() == pytest.approx(20.0, rel=1e-2)


def test_force_loads_the_drives_of_the_motion(tmp_path):
    free, loaded = (
        timed_motion(load(tmp_path, f"value = [0.0, 0.0, {size}]")) for size in (0.0, -60.0)
    )
    k = len(loaded.assessment.time) // 2
    robot = load(tmp_path, "value = [0.0, 0.0, 0.0]").robot
    q = loaded.assessment.position[k]
    added = loaded.assessment.torque[k] - np.array(
        [
            np.interp(loaded.assessment.time[k], free.assessment.time, column)
            for column in free.assessment.torque.T
        ]
    )
    wanted = robot.rigid_bodies().jacobian(robot.tool, q)[:3].T @ np.array([0.0, 0.0, 60.0])
    np.testing.assert_allclose(added, wanted, atol=0.02 * np.abs(wanted).max())


def test_lead_puts_the_loaded_tool_on_its_path(tmp_path):
    problem = load(tmp_path, "value = [0.0, 30.0, -40.0]")
    motion = timed_motion(problem).trajectory
    lead = force_lead(problem.robot, motion, motion.force)
    t = np.array([0.5 * motion.duration])
    q, bodies, tool = motion(t)[0], problem.robot.rigid_bodies(), problem.robot.tool
    torque = bodies.gravity_torque(q)
    pushed = torque - bodies.jacobian(tool, q)[:3].T @ np.array([0.0, 30.0, -40.0])
    from stiffopt.certificate.assess import joint_windup

    sag = joint_windup(problem.robot, np.stack([torque, pushed]))
    # Links are at the motors less the wind-up; the sag under weight alone is calibrated.
    off = bodies.jacobian(tool, q)[:3] @ (lead(t)[0] - (sag[1] - sag[0]))
    bare = bodies.jacobian(tool, q)[:3] @ (sag[1] - sag[0])
    assert np.linalg.norm(bare) > 1e-4
    assert np.linalg.norm(off) < 0.02 * np.linalg.norm(bare)


def test_table_has_forces_at_its_rows(tmp_path):
    rows = [f"350,{y},250,180,0,0,0,0,{k}" for k, y in enumerate(range(-50, 51, 10))]
    (tmp_path / "points.csv").write_text("\n".join(["x,y,z,rx,ry,rz,fx,fy,fz", *rows]) + "\n")
    text = PROBLEM[: PROBLEM.index("[path]")].format() + (
        '[path.table]\nfile = "points.csv"\nlength = "mm"\nangle = "deg"\n[path.force]\n'
        '[[minimise]]\nobjective = "duration"\n'
    )
    path = tmp_path / "problem.toml"
    path.write_text(text.replace("[path.force]\n", ""))
    with pytest.raises(InputError, match=r"no section says in which axes. Add \[path.force\]"):
        load_problem(path)
    table = (tmp_path / "points.csv").read_text()
    (tmp_path / "points.csv").write_text(table.replace(",7\n", ",70000\n"))
    path.write_text(text)
    with pytest.raises(InputError, match=r"7e\+04 N in points\.csv, row 8, 70 mm from the start"):
        load_problem(path)
    (tmp_path / "points.csv").write_text(table)
    force = load_problem(path).problem.path_force
    np.testing.assert_allclose(force(np.array([0.0, 0.35, 1.0]))[:, 2], [0.0, 3.5, 10.0], atol=1e-2)


@pytest.mark.parametrize(
    ("force", "words"),
    [
        ('value = [0.0, 0.0, "40 kN"]', r"in path\.segment\[\d\], .* mm .* torque limit of joint_"),
        ("value = [0.0, 0.0, 0.04]", "was kN meant"),
        ("value = [0.0, 0.0, 0.4]", "was kN meant"),
        ('value = [0.0, 0.0, 40.0]\nframe = "world"', "frame"),
    ],
)
def test_implausible_forces_are_told_with_their_place(tmp_path, force, words):
    with pytest.raises(InputError, match=words):
        load(tmp_path, force)


def test_estimated_torque_limits_are_told_beside_the_force(tmp_path):
    robot = load(tmp_path, "value = [0.0, 0.0, 10.0]").robot
    ends = np.array([robot.position_lower, robot.position_upper]) / 4.0
    force = PathForce(np.array([0.0, 1.0]), np.full((2, 3), 5e3), np.zeros((2, 3)), FRAMES)
    estimated = replace(
        robot,
        sources=[Source(name, "", "torque_max", "estimated", "") for name in robot.joint_names],
    )
    stated = replace(robot, sources=[])
    for arm, told in ((stated, False), (estimated, True)):
        with pytest.raises(ProblemError, match="N m") as caught:
            check_path_force(arm, JointPath.through(ends), force, 0.0, 1.0, lambda _: "row 1")
        assert ("marks as estimated" in str(caught.value)) is told


SIDEWAYS = """value = [0.0, 10.0, 5.0]
per_feed = [0.0, 400.0, 0.0]
frame = "path"
deflection_limit = "{limit}"
deflection_direction = "{direction}"
"""


def side_deflection(problem, s, feed):
    """Deflection (K,) to the side of the path [m]; it goes along y, its side is x of the base."""
    force = problem.path_force(s, feed)
    return np.abs(ProcessDeflection(problem.robot, problem.path(s))(force)[:, 0])


def test_speed_is_lowered_until_the_deflection_to_the_side_is_kept(tmp_path):
    s = np.linspace(0.0, 1.0, 301)
    problem = load(tmp_path, SIDEWAYS.format(limit="1 m", direction="side"))
    free = side_deflection(problem, s, np.full(len(s), 0.1)).max()
    limit = 0.6 * free
    problem = load(tmp_path, SIDEWAYS.format(limit=f"{limit} m", direction="side"))
    speeds = problem.path.speeds
    assert 0.01 < speeds.min() < 0.09
    feed = speeds[problem.path.piece_index(s)]
    assert side_deflection(problem, s, feed).max() == pytest.approx(limit, rel=2e-3)
    slowed = timed_motion(problem).objective
    assert slowed > 1.2


def test_deflection_limit_that_no_speed_keeps_is_named_with_its_place(tmp_path):
    with pytest.raises(InputError, match="constant force alone deflects the tool by"):
        load(tmp_path, SIDEWAYS.format(limit="1 um", direction="any"))


def test_deflection_limit_is_that_of_the_certificates_process_deflection(tmp_path):
    problem = load(tmp_path, SIDEWAYS.format(limit="1 m", direction="any"))
    motion = timed_motion(problem).assessment
    moved = ProcessDeflection(problem.robot, motion.position)(motion.force)
    # In motion the springs are at other torques, where their stiffness differs a little.
    peak = np.linalg.norm(moved, axis=1).max()
    certified = np.linalg.norm(motion.deflection["process"], axis=1).max()
    assert peak == pytest.approx(certified, rel=0.02)
