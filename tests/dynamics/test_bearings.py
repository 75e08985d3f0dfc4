"""Symbolic deflection of output bearings against the numeric one."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from stiffopt.drivetrain.bearing import OutputBearing
from stiffopt.dynamics.bearings import bearing_deflection, dynamic_bearing_displacements
from stiffopt.robot.bearings import bearing_deflections, dynamic_bearing_deflections
from stiffopt.robot.files import load_robot


def test_displacements_equal_the_numeric_ones() -> None:
    robot = load_robot("er3a_c60").with_payload(2.0, (0.0, 0.02, 0.05))
    stiff = OutputBearing(
        moment_stiffness=1e5, axial_stiffness=1e8, radial_stiffness=5e7, position=0.04
    )
    robot = replace(robot, bearings=(stiff, None, stiff.times(0.5), stiff, None, stiff.times(0.1)))
    motion = [ca.SX.sym(name, robot.n) for name in "qva"]
    found = dynamic_bearing_displacements(robot, *motion)
    assert sorted(found) == [0, 2, 3, 5]
    values = ca.Function("bearings", motion, [ca.horzcat(*found.values())])
    random = np.random.default_rng(2)
    for _ in range(3):
        own = [random.uniform(-1.0, 1.0, robot.n) * size for size in (1.0, 3.0, 20.0)]
        expected = dynamic_bearing_deflections(robot, *(x[None] for x in own))[0, :, :3]
        got = np.array(values(*own)).T
        np.testing.assert_allclose(got, expected[sorted(found)], rtol=1e-9, atol=1e-15)


def test_parts_under_a_force_equal_the_numeric_ones() -> None:
    robot = load_robot("er3a_c60").with_payload(2.0, (0.0, 0.02, 0.05))
    stiff = OutputBearing(moment_stiffness=1e5, axial_stiffness=1e8, radial_stiffness=5e7)
    robot = replace(robot, bearings=(stiff, None, stiff.times(0.5), None, stiff.times(0.1), None))
    motion = [ca.SX.sym(name, robot.n) for name in "qva"]
    force = np.array([30.0, -50.0, 20.0])
    found = bearing_deflection(robot, *motion, force)
    parts = ca.Function("parts", motion, [found.static, found.dynamic, found.process])
    random = np.random.default_rng(4)
    own = [random.uniform(-1.0, 1.0, robot.n) * size for size in (1.0, 3.0, 20.0)]
    q, v, a = (x[None] for x in own)
    rest, held, whole = (
        bearing_deflections(robot, q, *more)[0, :, :3].sum(axis=0)
        for more in ((), (None, None, force), (v, a, force))
    )
    expected = (rest, whole - held, held - rest)
    for got, right in zip(parts(*own), expected, strict=True):
        np.testing.assert_allclose(np.array(got)[:, 0], right, rtol=1e-9, atol=1e-15)
