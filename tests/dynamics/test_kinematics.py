from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from arms import NAMES, arm, states

from stiffopt.dynamics.kinematics import (
    point_jacobian,
    point_position,
    tool_pose,
)
from stiffopt.robot.body_tree import body_tree

OFFSET = np.array([0.1, -0.25, 0.3])
TURN = pin.rpy.rpyToMatrix(0.4, -1.0, 2.0)


def with_tool(name: str) -> tuple[pin.Model, int, int]:
    model = arm(name)
    joint = model.njoints - 1
    place = pin.SE3(TURN, OFFSET)
    frame = model.addFrame(pin.Frame("tool", joint, 0, place, pin.FrameType.OP_FRAME), False)
    return model, joint, frame


@pytest.mark.parametrize("name", NAMES)
def test_pose_and_jacobian_are_those_of_pinocchio(name: str) -> None:
    model, joint, frame = with_tool(name)
    data = model.createData()
    tree, symbol = body_tree(model), ca.SX.sym("q", model.nv)
    found = (
        *tool_pose(tree, joint, OFFSET, TURN, symbol),
        point_jacobian(tree, joint, OFFSET, symbol),
    )
    kinematics = ca.Function("kinematics", [symbol], list(found))
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for q, _, _ in states(model):
        expected = pin.computeFrameJacobian(model, data, q, frame, axes)[:3].copy()
        pin.framesForwardKinematics(model, data, q)
        placement = data.oMf[frame]
        position, rotation, jacobian = kinematics(q)
        scale = max(1.0, float(np.linalg.norm(placement.translation)))
        assert np.max(np.abs(np.asarray(position).ravel() - placement.translation)) < 1e-12 * scale
        assert np.max(np.abs(np.asarray(rotation) - placement.rotation)) < 1e-13 * 10
        assert np.max(np.abs(np.asarray(jacobian) - expected)) < 1e-12 * scale


@pytest.mark.parametrize("name", NAMES)
def test_jacobian_is_the_derivative_of_the_position(name: str) -> None:
    model, joint, _ = with_tool(name)
    q = ca.SX.sym("q", model.nv)
    gap = ca.jacobian(point_position(body_tree(model), joint, OFFSET, q), q)
    gap -= point_jacobian(body_tree(model), joint, OFFSET, q)
    function = ca.Function("gap", [q], [gap])
    for position, _, _ in states(model, 5):
        assert np.max(np.abs(np.asarray(function(position)))) < 1e-12


def test_joints_beyond_the_point_do_not_move_it() -> None:
    model = arm("tree")
    jacobian = point_jacobian(body_tree(model), 2, OFFSET, ca.SX(states(model, 1)[0][0]))
    assert np.all(np.asarray(ca.DM(jacobian))[:, 2:] == 0.0)
