"""Posture of a tool path: another branch where the first one ends, messages where none is left."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stiffopt.errors import InputError, ProblemError
from stiffopt.problem.files import load_problem
from stiffopt.problem.tool_path import ToolPath, ToolSegment, fit_tool_path
from stiffopt.robot.files import load_robot
from stiffopt.robot.frames import rotation_from_rpy


def line(start, rpy, step):
    end = np.add(start, step)
    return ToolPath(np.array(start), rotation_from_rpy(rpy), [ToolSegment(end=end)])


# Lines on which the posture nearest the middle of the joint ranges ends, at the place and for the
# cause that are told, and another one does not.
@pytest.mark.parametrize(
    ("arm", "start", "rpy", "step", "words"),
    [
        (
            "er3a_c60",
            [-0.1, -0.26, 0.15],
            [3.0, -0.3, 1.4],
            [-0.05, 0.06, -0.03],
            r"ends 0\.077 m along the path: stopped by joint_4 at its lower limit",
        ),
        (
            "ur10",
            [0.86, 0.11, 0.34],
            [3.6, 0.2, 0.6],
            [0.22, -0.02, -0.53],
            r"ends 0\.467 m along the path: the pose is singular, joints 3 and 4 would turn",
        ),
        (
            "ur10",
            [0.56, 0.47, 0.27],
            [3.2, -0.4, 1.2],
            [-0.02, 0.63, -0.05],
            r"ends 0\.490 m .* joints 3 and 4 would turn at any speed; the tool is within reach",
        ),
    ],
)
def test_a_branch_that_follows_the_whole_path_is_taken(arm, start, rpy, step, words):
    robot, path = load_robot(arm), line(start, rpy, step)
    fitted = fit_tool_path(robot, path, None, 1e-4)
    shares = np.linspace(0.0, 1.0, 101)
    q = fitted.joints(shares)
    assert (q >= robot.position_lower).all()
    assert (q <= robot.position_upper).all()
    found = [robot.rigid_bodies().pose(robot.tool, each)[0] for each in q]
    np.testing.assert_allclose(found, path.poses(shares * path.length)[0], atol=2e-4)
    assert re.search(words, fitted.remark)
    assert "path.near" in fitted.remark


def test_a_stated_posture_is_kept():
    robot = load_robot("er3a_c60")
    path = line([-0.1, -0.26, 0.15], [3.0, -0.3, 1.4], [-0.05, 0.06, -0.03])
    with pytest.raises(ProblemError, match=r"path, 0\.077 m .*joint_4 .*path\.near"):
        fit_tool_path(robot, path, np.zeros(6), 1e-4)


def test_the_posture_that_comes_farthest_is_told():
    robot = load_robot("er3a_c60")
    path = line([0.11, 0.19, 0.08], [3.0, -0.2, 1.0], [-0.09, -0.12, 0.06])
    words = (
        r"to its end at 0\.162 m; of 2 tried from its start, posture .*wrist flip \[.*\] rad comes "
        r"farthest\. It ends after 0\.074 m: stopped by joint_3 at its lower limit .*path\.near"
    )
    with pytest.raises(ProblemError, match=words):
        fit_tool_path(robot, path, None, 1e-4)


def test_a_full_turn_keeps_a_joint_from_its_limit():
    robot = load_robot("ur10")
    begin = np.array([0.3, -1.2, 1.6, -0.6, 1.4, 0.5])
    room = np.array([0.6, 0.6, 0.6, 0.6, 0.6, np.inf])
    lower, upper = begin - room, begin + room
    # One branch is left, whose last joint turns by 2.5 rad along the path.
    lower[5], upper[5] = -6.2, 2.0
    robot = replace(robot, position_lower=lower, position_upper=upper)
    place, turned = robot.rigid_bodies().pose(robot.tool, begin)
    end = turned @ rotation_from_rpy([0.0, 0.0, 2.5])
    aside = place + np.array([0.05, 0.0, 0.0])
    path = ToolPath(place, turned, [ToolSegment(end=aside, rotation=end)])
    fitted = fit_tool_path(robot, path, None, 1e-4)
    assert fitted.joints.points[0][5] == pytest.approx(0.5 - 2.0 * np.pi, abs=1e-6)
    assert "stopped by j6 at its upper limit 2" in fitted.remark


def test_limits_of_the_problem_end_a_posture(tmp_path):
    path = tmp_path / "problem.toml"
    path.write_text("""schema = 1
kind = "trajectory"
robot = "er3a_c60"

[motion]
duration = { lower = "0.3 s" }

[path]
start = { position = ["350 mm", "-150 mm", "250 mm"], rpy = ["180 deg", 0, 0] }

[[path.segment]]
type = "lin"
to = { position = ["350 mm", "150 mm", "250 mm"] }

[limits]
position_upper = [0.1, 1.5, 1.5, 3.1, 1.9, 6.2]

[[minimise]]
objective = "duration"
""")
    words = r"comes farthest.*joint_1 at its upper limit 0\.1.*kept at stops"
    with pytest.raises(InputError, match=words):
        load_problem(path)
