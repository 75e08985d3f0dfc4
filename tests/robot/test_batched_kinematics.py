"""Torques of single bodies and the tool along motions, against pinocchio instant by instant."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from gantry_arm import gantry

from stiffopt.robot.batched_kinematics import body_torque_regressor, frame_positions, tool_jacobians
from stiffopt.robot.body_tree import body_tree
from stiffopt.robot.files import load_robot
from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.rigid_body import BodiesInMotion, RigidBodies, without_rotors

# A column that turns, carries the gantry askew, and beside it an arm of its own.
BRANCHED = (
    gantry()
    .replace('<link name="base">', '<link name="floor"/><link name="base">')
    .replace(
        "</robot>",
        '<joint name="turn" type="revolute"><parent link="floor"/><child link="base"/>'
        '<origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/><axis xyz="0.6 0 0.8"/>'
        '<limit lower="-3" upper="3" effort="10" velocity="3"/></joint><link name="side">'
        '<inertial><origin xyz="0.1 0 0.05"/><mass value="2"/><inertia ixx="1e-2" ixy="1e-3"'
        ' ixz="2e-3" iyy="3e-2" iyz="-1e-3" izz="4e-2"/></inertial></link><joint name="branch"'
        ' type="revolute"><parent link="cart"/><child link="side"/><origin xyz="0 0 0.2"'
        ' rpy="1 0 0"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="10" velocity="3"/>'
        "</joint></robot>",
    )
)
MODELS = {
    "er3a": load_robot("er3a_c60").model,
    "branched": pin.buildModelFromXML(BRANCHED),
}
# More instants than are worked on at once.
COUNT = 2100


@pytest.fixture(params=MODELS)
def model(request):
    return MODELS[request.param]


@pytest.fixture
def motion(model):
    return np.random.default_rng(3).uniform(-2.0, 2.0, (3, COUNT, model.nv))


def test_body_torque_regressor_equals_pinocchio(model, motion) -> None:
    tree, bare = body_tree(model), without_rotors(model)
    own = np.concatenate([body_torque_regressor(tree, b, *motion) for b in range(tree.n)], axis=2)
    for k in (0, 1, COUNT - 1):
        expected = pin.computeJointTorqueRegressor(bare, bare.createData(), *motion[:, k])
        np.testing.assert_allclose(own[k], expected, atol=1e-12 * np.abs(expected).max())


def test_torque_change_equals_regressor_times_parameters(model, motion) -> None:
    tree = body_tree(model)
    change = np.random.default_rng(4).normal(0.0, 1.0, (tree.n, 10))
    change[0] = 0.0
    own = sum(body_torque_regressor(tree, b, *motion) @ change[b] for b in range(tree.n))
    torque = BodiesInMotion(model).changed_torque(change, *motion)
    np.testing.assert_allclose(torque, own, atol=1e-11 * np.abs(own).max())


def test_tool_positions_and_jacobians_equal_pinocchio(model, motion) -> None:
    exact = RigidBodies(model)
    for joint in (1, model.nv):
        frame = LinkFrame(joint, np.array([0.1, -0.2, 0.3]), np.eye(3))
        position, jacobian = tool_jacobians(body_tree(model), frame, motion[0])
        np.testing.assert_allclose(
            frame_positions(body_tree(model), frame, motion[0]), position, atol=1e-14
        )
        for k in (0, COUNT - 1):
            q = motion[0, k]
            np.testing.assert_allclose(position[k], exact.pose(frame, q)[0], atol=1e-13)
            np.testing.assert_allclose(jacobian[k], exact.jacobian(frame, q)[:3], atol=1e-13)
