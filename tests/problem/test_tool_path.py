"""Tool paths of lines and arcs: geometry, joint spline, tool speed."""

import numpy as np
import pytest
from small_arms import write_robot

from stiffopt.errors import InputError, ProblemError
from stiffopt.problem.files import load_problem
from stiffopt.problem.tool_path import ToolPath, ToolSegment, joint_waypoints
from stiffopt.result.joint_path import JointPath
from stiffopt.robot.files import load_robot
from stiffopt.robot.frames import rotation_from_rpy

ORIGIN, X, Y = np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
FRAME = np.eye(3)


def test_line_segment_is_straight():
    path = ToolPath(
        ORIGIN, FRAME, [ToolSegment(end=2 * X, rotation=rotation_from_rpy([0, 0, 1.0]))]
    )
    assert path.length == pytest.approx(2.0, rel=1e-12)
    positions, rotations = path.poses(np.array([0.0, 0.5, 2.0]))
    np.testing.assert_allclose(positions, [[0, 0, 0], [0.5, 0, 0], [2, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(rotations[1], rotation_from_rpy([0, 0, 0.25]), atol=1e-9)


@pytest.mark.parametrize(("side", "angle"), [(1.0, 0.5), (-1.0, 1.5)])
def test_arc_passes_its_intermediate_point(side, angle):
    """A quarter or three quarters of a circle about (1, 0) from the origin to (1, 1)."""
    through = X + side * np.array([-np.sqrt(0.5), np.sqrt(0.5), 0])
    path = ToolPath(ORIGIN, FRAME, [ToolSegment(end=X + Y, through=through)])
    assert path.length == pytest.approx(angle * np.pi, rel=1e-4)
    points, _ = path.poses(np.linspace(0, path.length, 50))
    np.testing.assert_allclose(np.linalg.norm(points - X, axis=1), 1.0, atol=1e-4)
    assert np.linalg.norm(points - through, axis=1).min() < 0.06


def test_corners_are_blended_by_a_parabola():
    corner = [ToolSegment(end=X, blend=0.2), ToolSegment(end=X + Y)]
    path = ToolPath(ORIGIN, FRAME, corner)
    points, _ = path.poses(np.linspace(0, path.length, 4001))
    # The parabola with both tangents through the corner: sqrt(1 - x) + sqrt(y) = sqrt(0.2).
    bend = points[(points[:, 0] > 0.8001) & (points[:, 1] < 0.1999)]
    value = np.sqrt(np.maximum(1 - bend[:, 0], 0)) + np.sqrt(bend[:, 1])
    np.testing.assert_allclose(value, np.sqrt(0.2), atol=3e-3)
    steps = np.diff(points, axis=0)
    turn = np.linalg.norm(np.diff(steps / np.linalg.norm(steps, axis=1)[:, None], axis=0), axis=1)
    assert turn.max() < 0.05
    with pytest.raises(ProblemError, match=r"segment\[1\]: the tool turns by 90 deg"):
        ToolPath(ORIGIN, FRAME, [ToolSegment(end=X), ToolSegment(end=X + Y)])
    with pytest.raises(ProblemError, match="its blends take"):
        ToolPath(ORIGIN, FRAME, [ToolSegment(end=X, blend=1.2), ToolSegment(end=X + Y)])


def test_tangential_segments_need_no_blend():
    arc = ToolSegment(end=2 * X + Y, through=X + np.array([np.sqrt(0.5), 1 - np.sqrt(0.5), 0]))
    path = ToolPath(ORIGIN, FRAME, [ToolSegment(end=X), arc])
    assert path.length == pytest.approx(1 + np.pi / 2, rel=1e-4)


@pytest.mark.parametrize(
    ("segment", "words"),
    [
        (ToolSegment(end=ORIGIN), "ends where it begins"),
        (ToolSegment(end=X, through=0.5 * X), "lie on a line"),
    ],
)
def test_invalid_segments_are_refused(segment, words):
    with pytest.raises(ProblemError, match=words):
        ToolPath(ORIGIN, FRAME, [segment])


def test_joint_spline_follows_the_path_within_the_tolerance():
    arm = load_robot("er3a_c60")
    down = rotation_from_rpy([np.pi, 0, 0])
    start, middle = np.array([0.35, -0.15, 0.25]), np.array([0.35, 0.0, 0.25])
    path = ToolPath(
        start,
        down,
        [
            ToolSegment(end=middle, blend=0.03),
            ToolSegment(end=np.array([0.42, 0.1, 0.25]), through=np.array([0.36, 0.08, 0.25])),
        ],
    )
    counts = []
    for tolerance in (1e-3, 2e-5):
        waypoints, error = joint_waypoints(arm, path, np.zeros(6), tolerance)
        counts.append(len(waypoints))
        assert error <= tolerance
        s = np.linspace(0, 1, 301)
        found = [arm.rigid_bodies().pose(arm.tool, q)[0] for q in JointPath.through(waypoints)(s)]
        wanted = path.poses(s * path.length)[0]
        assert np.linalg.norm(found - wanted, axis=1).max() <= 1.2 * tolerance
    assert counts[1] > counts[0]
    with pytest.raises(ProblemError, match="from its start"):
        joint_waypoints(arm, ToolPath(start, down, [ToolSegment(end=5 * X)]), np.zeros(6), 1e-4)


PROBLEM = """schema = 1
kind = "trajectory"
title = "A corner at constant speed"
robot = "er3a_c60"

[motion]
duration = { lower = "0.3 s", upper = "5 s" }

[path]
start = { position = ["350 mm", "-150 mm", "250 mm"], rpy = ["180 deg", 0, 0] }
speed = "0.2 m/s"
tolerance = "0.3 mm"

[[path.segment]]
type = "lin"
to = { position = ["350 mm", "0 mm", "250 mm"] }
blend = "30 mm"

[[path.segment]]
type = "lin"
to = { position = ["420 mm", "100 mm", "250 mm"] }

[[minimise]]
objective = "duration"

[limits]
jerk = "none"

[method]
intervals = 40
"""


POSE = "{ joints = [0, 0, 0, 0, 0, 0] }"


def write(tmp_path, text=PROBLEM):
    path = tmp_path / "problem.toml"
    path.write_text(text)
    return load_problem(path).problem


@pytest.mark.slow
def test_tool_speed_is_constant_between_the_ends(tmp_path):
    from stiffopt import solve

    solution = solve(write(tmp_path))
    motion = solution.assessment
    speed, moving = motion.tool_speed, (motion.time > 0.15) & (motion.time < motion.duration - 0.15)
    np.testing.assert_allclose(speed[moving], 0.2, rtol=0.01)
    assert speed.max() < 0.2 * 1.005
    # On the segments: at 250 mm height, on the first line where x is 350 mm.
    np.testing.assert_allclose(motion.tool[:, 2], 0.25, atol=3.1e-4)
    first = motion.tool[motion.tool[:, 1] < -0.031]
    np.testing.assert_allclose(first[:, 0], 0.35, atol=3.1e-4)
    assert any("within" in note and "waypoints" in note for note in solution.notes)


def test_a_path_is_read_as_waypoints_and_a_speed(tmp_path):
    problem = write(tmp_path)
    assert problem.path.shape[1] == 6
    assert problem.active_limits.tool_speed == 0.2
    (remark,) = problem.remarks
    assert "joint waypoints" in remark


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('type = "lin"', 'type = "circ"', "`through` belongs to"),
        ('blend = "30 mm"', "", "where it would have to stop"),
        ("[motion]\n", f"[motion]\nstart = {POSE}\nend = {POSE}\n", "Remove start"),
        ('speed = "0.2 m/s"', 'speed = "0 m/s"', "speed"),
    ],
)
def test_invalid_paths_are_refused(tmp_path, old, new, words):
    text = PROBLEM.replace(old, new, 1)
    with pytest.raises(InputError, match=words):
        write(tmp_path, text)


def test_motion_without_end_is_refused(tmp_path):
    write_robot(tmp_path)
    path = tmp_path / "problem.toml"
    path.write_text(
        'schema = 1\nkind = "trajectory"\nrobot = "planar.toml"\n[motion]\nduration = 1\n'
        '[[minimise]]\nobjective = "torque_squared"\n'
    )
    with pytest.raises(InputError, match="give `start` and `end`"):
        load_problem(path)
