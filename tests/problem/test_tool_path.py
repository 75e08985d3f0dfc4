"""Tool paths of lines and arcs: geometry, joint spline, tool speed."""

from dataclasses import replace

import numpy as np
import pytest
from small_arms import write_robot

from stiffopt.elastic.uncertainty import AssumedUncertainty
from stiffopt.errors import InputError, ProblemError
from stiffopt.path.timed_path import timed_motion
from stiffopt.problem.files import load_problem
from stiffopt.problem.tool_path import ToolPath, ToolSegment, fit_tool_path, spline_segments
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
    # A quarter of the way is 10/64 - 15/256 + 6/1024 of the turn.
    turned = 10 / 64 - 15 / 256 + 6 / 1024
    np.testing.assert_allclose(rotations[1], rotation_from_rpy([0, 0, turned]), atol=1e-9)


@pytest.mark.parametrize(("side", "angle"), [(1.0, 0.5), (-1.0, 1.5)])
def test_arc_passes_its_intermediate_point(side, angle):
    """A quarter or three quarters of a circle about (1, 0) from the origin to (1, 1)."""
    through = X + side * np.array([-np.sqrt(0.5), np.sqrt(0.5), 0])
    path = ToolPath(ORIGIN, FRAME, [ToolSegment(end=X + Y, through=through)])
    assert path.length == pytest.approx(angle * np.pi, rel=1e-4)
    points, _ = path.poses(np.linspace(0, path.length, 50))
    np.testing.assert_allclose(np.linalg.norm(points - X, axis=1), 1.0, atol=1e-4)
    assert np.linalg.norm(points - through, axis=1).min() < 0.06


def test_corners_are_blended_with_continuous_curvature():
    corner = [ToolSegment(end=X, blend=0.2), ToolSegment(end=X + Y)]
    path = ToolPath(ORIGIN, FRAME, corner)
    step = path.length / 8000
    points, _ = path.poses(np.linspace(0, path.length, 8001))
    inside = (points[:, 0] > 0.8) & (points[:, 1] < 0.2)
    assert np.linalg.norm(points[inside] - X, axis=1).min() == pytest.approx(0.066, abs=0.02)
    outside = points[~inside]
    assert np.minimum(np.abs(outside[:, 1]), np.abs(outside[:, 0] - 1.0)).max() < 1e-12
    curvature = np.linalg.norm(np.diff(points, 2, axis=0), axis=1) / step**2
    assert np.abs(np.diff(curvature)).max() < 0.02 * curvature.max()
    with pytest.raises(ProblemError, match=r"segment\[1\]: the tool turns by 90 deg"):
        ToolPath(ORIGIN, FRAME, [ToolSegment(end=X), ToolSegment(end=X + Y)])
    with pytest.raises(ProblemError, match="its blends take"):
        ToolPath(ORIGIN, FRAME, [ToolSegment(end=X, blend=1.2), ToolSegment(end=X + Y)])


def test_blend_between_a_line_and_an_arc_matches_the_curvature_of_both():
    arc = ToolSegment(end=X + 2 * Y, through=2 * X + Y)
    path = ToolPath(ORIGIN, FRAME, [ToolSegment(end=X, blend=0.1), arc])
    step = path.length / 8000
    points, _ = path.poses(np.linspace(0, path.length, 8001))
    curvature = np.linalg.norm(np.diff(points, 2, axis=0), axis=1) / step**2
    assert curvature[0] < 1e-3
    assert curvature[-1] == pytest.approx(1.0, rel=1e-3)
    assert np.abs(np.diff(curvature)).max() < 0.02 * curvature.max()


def test_stops_may_be_corners_and_divide_the_path():
    path = ToolPath(ORIGIN, FRAME, [ToolSegment(end=X, stop=True, dwell=0.3), ToolSegment(end=Y)])
    assert path.stops == pytest.approx([1.0])
    assert path.dwells == pytest.approx([0.3])
    assert path.parts() == [(0.0, pytest.approx(1.0)), (pytest.approx(1.0), path.length)]


def test_splines_pass_their_points_and_change_speed_without_a_bend():
    points = np.array([ORIGIN, X + 0.3 * Y, 2 * X, 3 * X + 0.2 * Y, 4 * X])
    speeds = np.array([1.0, 1.0, 1.0, 0.5, 0.5])
    segments = spline_segments(points, None, speeds, np.zeros(5, dtype=bool), list("abcde"))
    path = ToolPath(points[0], FRAME, segments)
    assert path.speeds.tolist() == [1.0, 0.5]
    found, _ = path.poses(np.linspace(0, path.length, 20001))
    for point in points:
        assert np.linalg.norm(found - point, axis=1).min() < 2e-4
    bend = np.linalg.norm(np.diff(found, 2, axis=0), axis=1) / (path.length / 20000) ** 2
    assert np.abs(np.diff(bend)).max() < 0.02 * bend.max()
    again = np.insert(points, 2, points[1], axis=0)
    with pytest.raises(ProblemError, match=r"p\.csv, row 3 repeats the point before"):
        spline_segments(
            again,
            None,
            np.ones(6),
            np.zeros(6, dtype=bool),
            [f"p.csv, row {k}" for k in range(1, 7)],
        )


def test_tangential_segments_need_no_blend():
    arc = ToolSegment(end=2 * X + Y, through=X + np.array([np.sqrt(0.5), 1 - np.sqrt(0.5), 0]))
    path = ToolPath(ORIGIN, FRAME, [ToolSegment(end=X), arc])
    assert path.length == pytest.approx(1 + np.pi / 2, rel=1e-4)


@pytest.mark.parametrize(
    ("segment", "words"),
    [
        (ToolSegment(end=ORIGIN), r"ends where it begins, at \[.*\] m.*delete it"),
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
        fitted = fit_tool_path(arm, path, np.zeros(6), tolerance)
        counts.append(len(fitted.joints.knots))
        assert fitted.error <= tolerance
        s = np.linspace(0, 1, 301)
        found = [arm.rigid_bodies().pose(arm.tool, q)[0] for q in fitted.joints(s)]
        wanted = path.poses(s * path.length)[0]
        assert np.linalg.norm(found - wanted, axis=1).max() <= 1.2 * tolerance
    assert counts[1] > counts[0]
    with pytest.raises(ProblemError, match="from its start"):
        fit_tool_path(arm, ToolPath(start, down, [ToolSegment(end=5 * X)]), np.zeros(6), 1e-4)


def test_knots_gather_in_small_blends_and_keep_off_the_lines():
    arm = load_robot("er3a_c60")
    start, down = np.array([0.32, -0.1, 0.2]), rotation_from_rpy([np.pi, 0, 0])
    corners = [start + np.array([0.06, 0, 0]), start + np.array([0.06, 0.2, 0])]
    segments = [ToolSegment(end=end, blend=1e-4) for end in corners]
    path = ToolPath(start, down, segments)
    fitted = fit_tool_path(arm, path, np.zeros(6), 5e-5)
    assert fitted.error <= 0.05 * 1e-4
    along = fitted.joints.knots * path.length
    in_blend = (along >= path.breaks[1]) & (along <= path.breaks[2])
    assert in_blend.sum() >= 4
    assert len(along) < 80


def test_singular_pose_on_a_path_is_told_with_its_place():
    arm = load_robot("er3a_c60")
    # The wrist is straight where the tool points along the forearm.
    bodies = arm.rigid_bodies()
    place, turned = bodies.pose(arm.tool, np.array([0.0, 0.3, 0.2, 0.0, 0.0, 0.0]))
    side = place + np.array([0.0, 0.1, 0.0])
    path = ToolPath(side, turned, [ToolSegment(end=place - np.array([0.0, 0.1, 0.0]))])
    with pytest.raises(ProblemError, match=r"path, 0\.\d+ m from its start: .*singular"):
        fit_tool_path(arm, path, np.array([0.2, 0.3, 0.2, 0.5, 0.3, -0.5]), 5e-5)


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
    # Backed off everywhere by the share that the speed exceeds its limit where a segment begins.
    np.testing.assert_allclose(speed[moving], 0.2, rtol=0.015)
    assert np.ptp(speed[moving]) < 0.2 * 1e-4
    assert speed.max() < 0.2 * 1.005
    # On the segments: at 250 mm height, on the first line where x is 350 mm.
    np.testing.assert_allclose(motion.tool[:, 2], 0.25, atol=3.1e-4)
    first = motion.tool[motion.tool[:, 1] < -0.031]
    np.testing.assert_allclose(first[:, 0], 0.35, atol=3.1e-4)
    assert any("within" in note and "waypoints" in note for note in solution.notes)


def test_a_path_is_read_as_waypoints_and_a_speed(tmp_path):
    problem = write(tmp_path)
    assert problem.path.joints == 6
    assert problem.active_limits.tool_speed == 0.2
    (remark,) = problem.remarks
    assert "joint waypoints" in remark


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('type = "lin"', 'type = "circ"', "`through` belongs to"),
        ('blend = "30 mm"', "", "where it would have to stop"),
        ('blend = "30 mm"', 'blend = "500 mm"', r"path\.segment\[1\].*blends take"),
        ("[motion]\n", f"[motion]\nstart = {POSE}\nend = {POSE}\n", "Remove start"),
        ('speed = "0.2 m/s"', 'speed = "0 m/s"', "speed"),
    ],
)
def test_invalid_paths_are_refused(tmp_path, old, new, words):
    text = PROBLEM.replace(old, new, 1)
    with pytest.raises(InputError, match=words):
        write(tmp_path, text)


TABLE = """schema = 1
kind = "trajectory"
robot = "er3a_c60"

[motion]
duration = { lower = "0.3 s" }

[path]
frame = { position = ["350 mm", 0, "200 mm"], rpy = [0, 0, "90 deg"] }
near = [0, 0, 0, 0, 0.5, 0]

[path.table]
file = "points.csv"
length = "mm"
angle = "deg"
speed = "m/s"

[[minimise]]
objective = "duration"
"""


def write_table(tmp_path, rows, head="x,y,z,rx,ry,rz,speed,label"):
    (tmp_path / "points.csv").write_text("\n".join([head, *rows]) + "\n")
    return write(tmp_path, TABLE)


def test_path_of_a_table_stands_in_its_work_frame(tmp_path):
    rows = [f"{x},{20 * np.sin(0.05 * x)},0,180,0,-90,0.{1 + (x > 0)},p" for x in range(-80, 81, 8)]
    problem = write_table(tmp_path, rows)
    ends = [
        problem.robot.rigid_bodies().pose(problem.robot.tool, q)[0] for q in problem.path.points
    ]
    # x of the frame is y of the base, and y its negative x.
    np.testing.assert_allclose(ends[0], [0.35 - 0.02 * np.sin(-4.0), -0.08, 0.2], atol=1e-6)
    np.testing.assert_allclose(ends[-1][1], 0.08, atol=1e-6)
    assert set(problem.path.speeds) == {0.1, 0.2}


@pytest.mark.parametrize(("unit", "speed"), [("", 0.1), ('speed = "cm/min"', 1.0 / 60.0)])
def test_table_with_decimal_commas_and_speeds_of_its_lengths(tmp_path, unit, speed):
    rows = [f"{x};0,0;{0.25 * x:.2f};180;0;-90;100,0;seam" for x in range(0, 81, 8)]
    text = "\ufeffx;y; z;rx;ry;rz;speed;label\n" + "\n".join(rows).replace(".", ",") + "\n"
    (tmp_path / "points.csv").write_text(text)
    problem = write(tmp_path, TABLE.replace('speed = "m/s"', unit))
    assert problem.path.speeds == pytest.approx(np.full(len(problem.path.speeds), speed))
    end = problem.robot.rigid_bodies().pose(problem.robot.tool, problem.path.points[-1])[0]
    assert end[2] == pytest.approx(0.2 + 0.02, abs=1e-6)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("8,0,0,180,0,-90,0.1,root", r"points\.csv, row 3 \(root\) repeats the point before"),
        ("16,0,0,180,0,-90,-0.1,a", "row 3, speed"),
        ("16,0,0,180,0,-90,100,a", r"row 3, speed: 100 m/s .* path\.table\.speed: .*cm/min"),
        ("16,0,,180,0,-90,0.1,a", "row 3, z"),
        ("9000,0,0,180,0,-90,0.1,a", "from its start"),
        ("9e6,0,0,180,0,-90,0.1,a", r"row 3, x: 9e\+06 mm is beyond 100 m"),
    ],
)
def test_faults_of_a_table_are_told_with_their_row(tmp_path, row, words):
    rows = ["0,0,0,180,0,-90,0.1,a", "8,0,0,180,0,-90,0.1,a", row, "24,0,0,180,0,-90,0.1,a"]
    with pytest.raises(InputError, match=words):
        write_table(tmp_path, rows)


def test_orientations_of_a_table_may_be_called_roll_pitch_and_yaw(tmp_path):
    rows = [f"{x},0,0,180,0,{-90 + x / 2},0.1,a" for x in range(0, 33, 8)]
    points = [
        write_table(tmp_path, rows, f"x,y,z,{names},speed,label").path.points
        for names in ("rx,ry,rz", "roll,pitch,yaw")
    ]
    np.testing.assert_array_equal(*points)
    with pytest.raises(
        InputError, match=r"lacks the columns yaw: roll, pitch, yaw belong together"
    ):
        write_table(tmp_path, rows, "x,y,z,roll,pitch,angle,speed,label")


def test_table_with_two_kinds_of_orientations_is_refused(tmp_path):
    rows = [f"{x},0,0,180,0,-90,0,0,0,1,0.1,a" for x in range(0, 33, 8)]
    for names in ("rx,ry,rz,qx,qy,qz,qw", "roll,pitch,yaw,qx,qy,qz,qw"):
        with pytest.raises(InputError, match=f"several orientations .* {names.replace(',', ', ')}"):
            write_table(tmp_path, rows, f"x,y,z,{names},speed,label")


def test_table_in_other_units_than_stated_is_refused(tmp_path):
    rows = [f"{x},0,0,180,0,-90,0.1,a" for x in range(0, 33, 8)]
    (tmp_path / "points.csv").write_text("x,y,z,rx,ry,rz,speed,label\n" + "\n".join(rows) + "\n")
    text = "\n".join(line for line in TABLE.splitlines() if not line.startswith("angle"))
    with pytest.raises(InputError, match=r"row 1, rx: 180 rad .* path\.table\.angle, such as .deg"):
        write(tmp_path, text)


def test_motion_rests_at_stops_and_keeps_the_speeds_of_its_segments(tmp_path):
    text = PROBLEM.replace('blend = "30 mm"', 'stop = true\ndwell = "0.2 s"\nspeed = "0.1 m/s"')
    text = text.replace('[limits]\njerk = "none"\n', "")
    problem = write(tmp_path, text)
    found = timed_motion(problem)
    motion = found.assessment
    resting = np.abs(motion.velocity).max(axis=1) < 1e-6
    inner = resting & (motion.time > 0.1) & (motion.time < motion.duration - 0.1)
    assert np.ptp(motion.time[inner]) == pytest.approx(0.2, abs=0.02)
    np.testing.assert_allclose(motion.tool[inner], [[0.35, 0.0, 0.25]] * inner.sum(), atol=1e-5)
    before = motion.time < motion.time[inner][0]
    assert motion.tool_speed[before].max() == pytest.approx(0.1, rel=5e-3)
    assert motion.tool_speed[~before].max() == pytest.approx(0.2, rel=5e-3)
    assert np.max(np.abs(motion.jerk) / problem.active_limits.jerk) <= 1.005


def test_motion_whose_motors_lead_rests_at_stops_as_well(tmp_path):
    text = PROBLEM.replace('blend = "30 mm"', "stop = true").replace(
        '[limits]\njerk = "none"\n', ""
    )
    problem = write(tmp_path, text + "\n[uncertainty]\nstiffness = 0.2\n")
    assert problem.leads_on_path
    motion = timed_motion(problem).assessment
    fastest = timed_motion(replace(problem, uncertainty=AssumedUncertainty())).assessment
    # Averaged over 40 ms twice in each of the two parts.
    assert motion.duration == pytest.approx(fastest.duration + 4 * 0.04, abs=0.02)
    away = np.linalg.norm(motion.tool - problem.path.corners[0], axis=1)
    at = int(np.argmin(away))
    assert away[at] < 2e-5
    assert np.abs(motion.velocity[at]).max() < 1e-3
    assert motion.tool_speed.max() > 0.15


def test_motion_without_end_is_refused(tmp_path):
    write_robot(tmp_path)
    path = tmp_path / "problem.toml"
    path.write_text(
        'schema = 1\nkind = "trajectory"\nrobot = "planar.toml"\n[motion]\nduration = 1\n'
        '[[minimise]]\nobjective = "torque_squared"\n'
    )
    with pytest.raises(InputError, match="give `start` and `end`"):
        load_problem(path)
