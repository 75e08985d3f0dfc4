from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from stiffopt.baseline.rivals import quintic_law
from stiffopt.errors import ProblemError
from stiffopt.result.joint_path import JointPath
from stiffopt.result.trajectory import Trajectory

POINTS = np.array([[-1.0, 0.5], [-0.4, 0.7], [0.4, -0.2], [0.6, -0.9], [1.0, 0.1]])


def test_two_waypoints_are_joined_by_a_straight_line() -> None:
    path = JointPath.through(POINTS[[0, -1]])
    s = np.linspace(0, 1, 11)
    line = POINTS[0] + s[:, None] * (POINTS[-1] - POINTS[0])
    assert path(s) == pytest.approx(line, abs=1e-15)
    assert np.all(np.abs(path(s, 2)) < 1e-14)


@pytest.mark.parametrize("spacing", ["uniform", "chord"])
def test_more_waypoints_are_joined_by_the_not_a_knot_spline(spacing: str) -> None:
    path = JointPath.through(POINTS, spacing)
    assert path(path.knots) == pytest.approx(POINTS, abs=1e-14)
    spline = CubicSpline(path.knots, POINTS, bc_type="not-a-knot")
    s = np.linspace(0, 1, 101)
    for order in range(4):
        assert path(s, order) == pytest.approx(spline(s, order), rel=1e-12, abs=1e-10)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ([[1.0], [2.0], [2.0]], "does not move from number 2 on"),
        ([[1.0], [1.0]], "does not move from number 1 on"),
        ([[1.0]], "at least two waypoints, start and end included, each different"),
    ],
)
def test_path_with_equal_waypoints_is_refused_with_their_number(
    points: list[list[float]], said: str
) -> None:
    with pytest.raises(ProblemError, match=said):
        JointPath.through(points)


def test_chord_spacing_follows_the_distances() -> None:
    path = JointPath.through([[0.0], [1.0], [4.0]], "chord")
    assert path.knots == pytest.approx([0.0, 0.25, 1.0])


@pytest.mark.parametrize(
    "law",
    [
        quintic_law(1.3),
        # Bang-bang: the path speed rises and falls at constant rate.
        Trajectory.from_acceleration([0.0, 0.5, 1.0], [[[4.0]], [[-4.0]]], [0.0], [0.0]),
    ],
)
def test_composed_motion_is_exact(law: Trajectory) -> None:
    path = JointPath.through(POINTS, "chord")
    motion = path.follow(law)
    t = np.linspace(0.0, law.duration, 997)
    s, ds, dds = law(t)[:, 0], law(t, 1), law(t, 2)
    assert motion(t) == pytest.approx(path(s), abs=1e-12)
    assert motion(t, 1) == pytest.approx(path(s, 1) * ds, abs=1e-11)
    assert motion(t, 2) == pytest.approx(path(s, 1) * dds + path(s, 2) * ds**2, abs=1e-10)


def test_quintic_rests_at_both_ends_with_its_known_peaks() -> None:
    duration = 0.8
    motion = JointPath.through(POINTS[[0, -1]]).follow(quintic_law(duration))
    ends = np.array([0.0, duration])
    assert motion(ends) == pytest.approx(POINTS[[0, -1]], abs=1e-13)
    assert np.max(np.abs(motion(ends, 1))) < 1e-12
    assert np.max(np.abs(motion(ends, 2))) < 1e-11
    t = np.linspace(0, duration, 20001)
    travel = np.abs(POINTS[-1] - POINTS[0])
    peak = 15.0 / 8.0 * travel / duration
    assert np.max(np.abs(motion(t, 1)), axis=0) == pytest.approx(peak, rel=1e-7)
    peak = 10.0 / np.sqrt(3.0) * travel / duration**2
    assert np.max(np.abs(motion(t, 2)), axis=0) == pytest.approx(peak, rel=1e-7)


def test_unknown_spacing_is_refused() -> None:
    with pytest.raises(ProblemError, match="Allowed: chord, uniform"):
        JointPath.through(POINTS, "arc")


def test_knot_beside_a_break_by_rounding_adds_no_piece_of_mixed_jerk() -> None:
    """At corners the law's jerk jumps against the path's; their sum keeps its limit."""
    knot = 0.25
    bend = np.array([[[0.0], [1.0], [0.0], [8.0]], [[0.125], [2.5], [6.0], [-9.0]]])
    path = JointPath(np.array([0.0, knot, 1.0]), bend)
    for drift in (-1e-9, 1e-9, 0.0):
        # Passes the knot at 0.5 s, with jerks of 12 and -8 on its sides.
        before, after = [[0.0], [12.0]], [[6.0], [-8.0]]
        law = Trajectory.from_acceleration([0.0, 0.5, 0.8], [before, after], [drift], [0.0])
        motion = path.follow(law)
        assert motion.times == pytest.approx([0.0, 0.5, 0.8], abs=1e-12)
        assert len(motion.times) == 3
