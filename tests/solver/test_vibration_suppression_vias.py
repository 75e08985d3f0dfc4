"""Vias are kept by motors changed for vibration suppression."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from small_arms import load

from stiffopt import Target
from stiffopt.command.motor_change import _Splines, _via_rows
from stiffopt.result.assessment import Violation

TIMES = np.linspace(0.0, 1.0, 101)
AT = 40


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    return load(tmp_path_factory.mktemp("arm"))


def rows_of(problem, via, position):
    """Rows of one via passed at 0.4 s, with the response to coefficients there."""
    splines, joints = _Splines(1.0), np.arange(problem.joints)
    now = SimpleNamespace(
        time=TIMES,
        position=np.tile(position, (len(TIMES), 1)),
        violations=(Violation(-0.1, "via_1", None, float(TIMES[AT])),),
    )
    asked = SimpleNamespace(robot=problem.robot, vias=(via,), joints=problem.joints)
    [(rows, lower, upper)] = _via_rows(asked, now, splines, joints)
    random = np.random.default_rng(4)
    change = 1e-6 * random.normal(size=(len(joints), splines.count))
    moved = (splines(TIMES[AT : AT + 1]) @ change.T)[0]
    return rows @ change.ravel(), lower, upper, moved


def test_joints_use_remaining_via_tolerance(problem):
    position = np.array([0.2, 0.3])
    via = Target(joints=position + np.array([0.004, -0.01]), tolerance=0.01)
    found, lower, upper, moved = rows_of(problem, via, position)
    np.testing.assert_allclose(found, moved / 0.01, rtol=1e-9)
    np.testing.assert_allclose(lower, [-0.6, -2.0], atol=1e-9)
    # At the edge: no further, whatever rounding says.
    np.testing.assert_allclose(upper, [1.4, 0.0], atol=1e-9)
    assert np.all(lower <= 0.0)
    assert np.all(upper >= 0.0)


@pytest.mark.parametrize("turned", [False, True])
def test_tool_is_fixed_at_its_via(problem, turned):
    position, tool = np.array([0.2, 0.3]), problem.robot.tool
    bodies = problem.robot.rigid_bodies()
    place, _ = bodies.pose(tool, position)
    rpy = [0.0, 0.5, 0.0] if turned else None
    via = Target(position=place + np.array([1e-3, 0.0, 0.0]), rpy=rpy, tolerance=1e-3)
    found, lower, upper, moved = rows_of(problem, via, position)
    assert len(found) == (6 if turned else 3)
    after, _ = bodies.pose(tool, position + moved)
    np.testing.assert_allclose(found[:3], (after - place) / 1e-3, atol=1e-6)
    np.testing.assert_array_equal(lower, -upper)
    assert np.all(upper < 5e-3)
