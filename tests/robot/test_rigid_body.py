"""Numbers of the rigid bodies, plain data of them, and robots with joints held still."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from small_arms import ROOT

from stiffopt.certificate.rigid_body import link_torques
from stiffopt.errors import RobotError
from stiffopt.robot.files import load_robot
from stiffopt.robot.frames import (
    interpolate_rotation,
    named_frame,
    rotation_from_rpy,
    rotation_vector,
    rpy_from_rotation,
)
from stiffopt.robot.urdf import load_urdf

ROBOT = load_robot("er3a_c60")
MODEL = ROBOT.model
Q, V, A = np.random.default_rng(4).uniform(-1.0, 1.0, (3, 6))


def test_inertial_parameters_are_those_of_pinocchio_and_give_the_torque() -> None:
    for body, inertia in zip(ROBOT.tree.bodies, list(ROBOT.model.inertias)[1:], strict=True):
        expected = inertia.toDynamicParameters()
        np.testing.assert_allclose(body.inertial_parameters, expected, atol=1e-14)
    parameters = np.concatenate([body.inertial_parameters for body in ROBOT.tree.bodies])
    bodies = ROBOT.rigid_bodies()
    torque = pin.computeJointTorqueRegressor(MODEL, MODEL.createData(), Q, V, A) @ parameters
    np.testing.assert_allclose(torque, bodies.torque(Q, V, A), atol=1e-11)


def test_torque_is_inertia_times_acceleration_plus_bias() -> None:
    bodies = ROBOT.rigid_bodies()
    added = bodies.torque(Q, V, A) - bodies.torque(Q, V, np.zeros(6))
    np.testing.assert_allclose(bodies.inertia_matrix(Q) @ A, added, atol=1e-11)
    held = bodies.torque(Q, np.zeros(6), np.zeros(6))
    np.testing.assert_allclose(bodies.gravity_torque(Q), held, atol=1e-12)


@pytest.mark.parametrize("joints", [1, 6])
@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("parallel", [True, False])
def test_torques_of_many_instants_with_and_without_the_parallel_call(
    monkeypatch, joints, count, parallel
) -> None:
    robot = ROBOT.with_joints_locked(ROBOT.joint_names[joints:])
    motion = np.random.default_rng(5).uniform(-1.0, 1.0, (3, count, 9))[:, :, :joints]
    bodies = robot.rigid_bodies()
    expected = [bodies.torque(*each) for each in zip(*motion, strict=True)]
    if not parallel:
        # Of pinocchio as it is where it was built without OpenMP.
        for name in ("rneaInParallel", "ModelPool"):
            monkeypatch.delattr(pin, name, raising=False)
    np.testing.assert_allclose(robot.bodies_in_motion().torque(*motion), expected, atol=1e-11)
    np.testing.assert_allclose(link_torques(robot, *motion), expected, atol=1e-11)


def test_changed_gravity_applies_to_a_copy() -> None:
    bodies, before = ROBOT.rigid_bodies(), ROBOT.rigid_bodies().gravity_torque(Q)
    np.testing.assert_allclose(
        bodies.with_gravity(np.array([0.0, 0.0, 4.905])).gravity_torque(Q), -0.5 * before
    )
    upside_down = ROBOT.with_gravity((0.0, 0.0, 9.81))
    np.testing.assert_allclose(upside_down.rigid_bodies().gravity_torque(Q), -before)
    np.testing.assert_array_equal(bodies.gravity_torque(Q), before)


def test_jacobian_is_the_change_of_the_pose() -> None:
    bodies, step = ROBOT.rigid_bodies(), 1e-6
    jacobian = bodies.jacobian(ROBOT.tool, Q)
    for j, turned in enumerate(step * np.eye(6)):
        (after, turn), (before, back) = (bodies.pose(ROBOT.tool, Q + s * turned) for s in (1, -1))
        np.testing.assert_allclose(jacobian[:3, j], (after - before) / (2 * step), atol=1e-8)
        rate = rotation_vector(turn @ back.T) / (2 * step)
        np.testing.assert_allclose(jacobian[3:, j], rate, atol=1e-8)


def test_locked_joints_give_a_reduced_robot() -> None:
    names = ROBOT.joint_names
    held = ROBOT.with_joints_locked((names[5], names[2]))
    left = np.array([0, 1, 3, 4])
    assert held.joint_names == tuple(names[j] for j in left)
    assert held.chains == tuple(ROBOT.chains[j] for j in left)
    np.testing.assert_array_equal(held.torque_max, ROBOT.torque_max[left])
    state = np.zeros((3, 6))
    state[:, left] = [Q[left], V[left], A[left]]
    whole, part = ROBOT.rigid_bodies(), held.rigid_bodies()
    torque = part.torque(*state[:, left])
    np.testing.assert_allclose(torque, whole.torque(*state)[left], atol=1e-11)
    for mine, own in ((held.tool, ROBOT.tool), (held.flange, ROBOT.flange)):
        poses = part.pose(mine, state[0, left]), whole.pose(own, state[0])
        for one, other in zip(*poses, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12)
    assert ROBOT.with_joints_locked(()) is ROBOT


def test_unphysical_inertia_keeps_that_of_the_body() -> None:
    body = ROBOT.tree.bodies[2]
    heavier = ROBOT.with_inertial_parameters(3, 2.0 * body.inertial_parameters).tree.bodies[2]
    assert heavier.mass == pytest.approx(2.0 * body.mass)
    np.testing.assert_allclose(heavier.inertia, 2.0 * body.inertia, atol=1e-15)
    impossible = body.inertial_parameters.copy()
    impossible[4] = -1.0
    kept = ROBOT.with_inertial_parameters(3, impossible).tree.bodies[2]
    np.testing.assert_allclose(kept.inertia, body.inertia, atol=1e-15)
    with pytest.raises(RobotError, match="mass above 0"):
        ROBOT.with_inertial_parameters(3, 0.0 * impossible)


def test_named_frames_equal_pinocchio() -> None:
    data = ROBOT.model.createData()
    pin.framesForwardKinematics(ROBOT.model, data, Q)
    bodies = ROBOT.rigid_bodies()
    for index, frame in enumerate(ROBOT.model.frames):
        position, rotation = bodies.pose(named_frame(ROBOT.model, frame.name), Q)
        np.testing.assert_allclose(position, data.oMf[index].translation, atol=1e-12)
        np.testing.assert_allclose(rotation, data.oMf[index].rotation, atol=1e-12)


def test_rotation_conversions_are_inverse_and_interpolate() -> None:
    first, last = (rotation_from_rpy(rpy) for rpy in ([0.3, -0.5, 1.1], [-0.2, 0.4, 0.1]))
    np.testing.assert_allclose(rpy_from_rotation(first), [0.3, -0.5, 1.1], atol=1e-12)
    np.testing.assert_allclose(interpolate_rotation(first, last, 1.0), last, atol=1e-12)
    half = interpolate_rotation(first, last, 0.5)
    np.testing.assert_allclose(
        rotation_vector(first.T @ half), rotation_vector(half.T @ last), atol=1e-12
    )


def test_inertia_below_atomic_size_is_refused(tmp_path):
    text = (ROOT / "problems" / "two_link.urdf").read_text()
    assert '"0.5"' in text
    path = tmp_path / "tiny.urdf"
    path.write_text(text.replace('"0.5"', '"1e-30"'))
    with pytest.raises(RobotError, match=r"link 'link_1'.*within an atom"):
        load_urdf(path)
    path.write_text(text.replace('"0.5"', '"0"'))
    load_urdf(path)
