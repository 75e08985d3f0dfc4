"""Poses and Jacobians of a tool relative to the work on a positioner, in every implementation."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from turntable_arm import write_ur10_with_turntable

from stiffopt.certificate.rigid_body import rigid_body_history, tool_positions
from stiffopt.dynamics.kinematics import frame_jacobian, frame_pose
from stiffopt.robot.batched_kinematics import frame_positions, frame_rotations, tool_jacobians
from stiffopt.robot.files import load_robot
from stiffopt.robot.frames import link_frame


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("turntable")
    write_ur10_with_turntable(folder)
    robot = load_robot(folder / "robot.toml")
    work = link_frame(robot.model, "table", [0.05, -0.02, 0.03], [0.1, 0.2, 0.3])
    return replace(robot, tool=replace(robot.tool, seen_from=work))


def test_arm_and_table_are_two_branches_and_the_tool_is_of_the_arm(arm):
    assert set(arm.joint_names) > {"turn"}
    assert arm.n == 7
    assert arm.joint_names[arm.tool.joint - 1] != "turn"


def test_all_kinematics_are_those_of_the_inverse_of_the_works_pose(arm):
    rng = np.random.default_rng(1)
    q = rng.uniform(-1.5, 1.5, (20, 7))
    bodies, tool = arm.rigid_bodies(), arm.tool
    expected = []
    for row in q:
        place, turned = bodies.pose(tool.in_base, row)
        origin, axes = bodies.pose(tool.seen_from, row)
        expected.append((axes.T @ (place - origin), axes.T @ turned))
    places, rotations = (np.stack(each) for each in zip(*expected, strict=True))
    step = 1e-6
    slopes = np.stack(
        [
            [
                (bodies.pose(tool, row + e)[0] - bodies.pose(tool, row - e)[0]) / (2 * step)
                for e in step * np.eye(7)
            ]
            for row in q
        ]
    ).swapaxes(1, 2)
    still = np.zeros_like(q)
    history = rigid_body_history(arm, q, still, still)
    position, jacobian = tool_jacobians(arm.tree, tool, q)
    joints = ca.SX.sym("q", 7)
    symbolic = ca.Function(
        "f",
        [joints],
        [*frame_pose(arm.tree, tool, joints), frame_jacobian(arm.tree, tool, joints)],
    )
    for k, row in enumerate(q):
        one = bodies.pose(tool, row)
        other = [np.asarray(each) for each in symbolic(row)]
        np.testing.assert_allclose(one[1], rotations[k], atol=1e-12)
        np.testing.assert_allclose(other[1], rotations[k], atol=1e-12)
        np.testing.assert_allclose([one[0], other[0].ravel()], [places[k]] * 2, atol=1e-12)
        for found in (bodies.jacobian(tool, row)[:3], other[2]):
            np.testing.assert_allclose(found, slopes[k], atol=1e-7)
    for found in (
        position,
        history.tool,
        frame_positions(arm.tree, tool, q),
        tool_positions(arm, q),
    ):
        np.testing.assert_allclose(found, places, atol=1e-12)
    np.testing.assert_allclose(frame_rotations(arm.tree, tool, q), rotations, atol=1e-12)
    for found in (jacobian, history.jacobian):
        np.testing.assert_allclose(found, slopes, atol=1e-7)


def test_angular_jacobian_is_relative_to_the_work(arm):
    q = np.linspace(-1.0, 1.0, 7)
    bodies = arm.rigid_bodies()
    found, step = bodies.jacobian(arm.tool, q)[3:], 1e-6
    for j, e in enumerate(step * np.eye(7)):
        change = bodies.pose(arm.tool, q + e)[1] @ bodies.pose(arm.tool, q - e)[1].T / (2 * step)
        spin = 0.5 * np.array(
            [change[2, 1] - change[1, 2], change[0, 2] - change[2, 0], change[1, 0] - change[0, 1]]
        )
        np.testing.assert_allclose(found[:, j], spin, atol=1e-6)
