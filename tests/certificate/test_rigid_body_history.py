"""Axes along a motion against pinocchio, which computes them one instant at a time."""

import numpy as np
import pinocchio as pin
import pytest

from stiffopt.certificate.rigid_body import (
    holding_torques,
    joint_geometries,
    moving_joints,
    point_jacobian,
)


def serial():
    return pin.buildSampleModelManipulator()


def branched():
    """Turning and sliding joints about slanted axes, on two branches."""
    model, draw = pin.Model(), np.random.default_rng(3)
    slanted = np.array([0.6, 0.0, 0.8])
    kinds = [
        pin.JointModelRZ(),
        pin.JointModelRevoluteUnaligned(slanted),
        pin.JointModelPY(),
        pin.JointModelPrismaticUnaligned(slanted),
        pin.JointModelRX(),
    ]
    for kind, parent in zip(kinds, (0, 1, 2, 1, 4), strict=True):
        joint = model.addJoint(parent, kind, pin.SE3.Random(), f"joint {len(model.names)}")
        held = pin.SE3(np.eye(3), draw.normal(size=3))
        model.appendBodyToJoint(joint, pin.Inertia.Random(), held)
    model.gravity.linear = np.array([1.0, -2.0, -9.0])
    return model


@pytest.mark.parametrize("made", [serial, branched])
def test_axes_along_a_motion_are_those_of_pinocchio(made):
    pin.seed(5)
    model = made()
    data, position = model.createData(), np.random.default_rng(1).normal(size=(7, model.nq))
    joints, offset = moving_joints(joint_geometries(model), position), np.array([0.1, -0.2, 0.3])
    weights = holding_torques(joints, model.gravity.linear)
    for carrier in range(1, model.njoints):
        place = joints[carrier - 1].point(offset)
        jacobian = point_jacobian(joints, carrier, place)
        frame = pin.Frame("tool", carrier, 0, pin.SE3(np.eye(3), offset), pin.FrameType.OP_FRAME)
        for k, q in enumerate(position):
            pin.computeJointJacobians(model, data, q)
            expected = pin.getFrameJacobian(
                model, data, carrier, frame.placement, pin.LOCAL_WORLD_ALIGNED
            )
            np.testing.assert_allclose(place[:, k], data.oMi[carrier].act(offset), atol=1e-13)
            np.testing.assert_allclose(jacobian[k], expected[:3], atol=1e-13)
            gravity = pin.computeGeneralizedGravity(model, data, q)
            np.testing.assert_allclose(weights[k], gravity, atol=1e-12)
