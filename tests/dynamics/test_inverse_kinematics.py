from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from arms import arm

from stiffopt.dynamics.inverse_kinematics import (
    UnreachablePoseError,
    solve_pose,
)
from stiffopt.errors import ProblemError
from stiffopt.robot.body_tree import body_tree
from stiffopt.robot.frames import LinkFrame, rotation_from_rpy
from stiffopt.robot.rigid_body import RigidBodies


def robot(name: str, bound: float = 3.0) -> SimpleNamespace:
    model = arm(name)
    turn = rotation_from_rpy([0.1, 0.2, 0.3])
    place = LinkFrame(model.njoints - 1, np.array([0.0, 0.05, 0.1]), turn)
    return SimpleNamespace(
        name=name,
        model=model,
        tool=place,
        rigid_bodies=lambda: RigidBodies(model),
        prismatic=body_tree(model).prismatic,
        joint_names=tuple(model.names)[1:],
        position_lower=np.full(model.nv, -bound),
        position_upper=np.full(model.nv, bound),
    )


def pose(arm_: SimpleNamespace, q: np.ndarray) -> pin.SE3:
    data = arm_.model.createData()
    pin.forwardKinematics(arm_.model, data, q)
    return data.oMi[arm_.tool.joint] * pin.SE3(arm_.tool.rotation, arm_.tool.offset)


@pytest.mark.parametrize("name", ["ur10", "er3a", "sample", "skew"])
@pytest.mark.parametrize("oriented", [False, True])
def test_round_trip(name: str, oriented: bool) -> None:
    arm_ = robot(name)
    if oriented and arm_.model.nv < 6:
        pytest.skip("five joints cannot take any orientation")
    rng = np.random.default_rng(2)
    for _ in range(10):
        q = rng.uniform(-2.0, 2.0, arm_.model.nv)
        place = pose(arm_, q)
        found = solve_pose(
            arm_, place.translation, place.rotation if oriented else None, q + rng.normal(0, 0.3)
        )
        assert np.all(np.abs(found) <= 3.0)
        assert pose(arm_, found).translation == pytest.approx(place.translation, abs=1e-9)
        if oriented:
            assert pose(arm_, found).rotation == pytest.approx(place.rotation, abs=1e-8)


def test_near_chooses_the_solution() -> None:
    arm_ = robot("ur10")
    q = np.array([0.3, -1.2, 1.5, -0.7, 0.9, 0.4])
    place = pose(arm_, q)
    assert solve_pose(arm_, place.translation, place.rotation, q + 0.05) == pytest.approx(
        q, abs=1e-6
    )


def test_equal_seeds_give_equal_angles_without_near() -> None:
    arm_ = robot("ur10")
    place = pose(arm_, np.array([0.3, -1.2, 1.5, -0.7, 0.9, 0.4]))
    first, second = (solve_pose(arm_, place.translation, place.rotation) for _ in range(2))
    assert np.array_equal(first, second)


def test_full_turns_are_removed() -> None:
    arm_ = robot("ur10", bound=2 * np.pi)
    q = np.array([0.3, -1.2, 1.5, -0.7, 0.9, 0.4])
    place = pose(arm_, q)
    found = solve_pose(arm_, place.translation, place.rotation, q + 2 * np.pi * (q < 0))
    assert found - 2 * np.pi * (q < 0) == pytest.approx(q, abs=1e-6)


def test_unreachable_position_states_distance() -> None:
    arm_ = robot("ur10")
    with pytest.raises(
        UnreachablePoseError, match=r"closest pose.* mm away.*reach of the links"
    ) as e:
        solve_pose(arm_, [5.0, 0.0, 0.5])
    reached = pose(arm_, e.value.joints).translation
    assert e.value.distance == pytest.approx(np.linalg.norm(reached - [5.0, 0.0, 0.5]), rel=1e-6)
    # The reach of this arm is well known: 1.3 m from the shoulder at a height of 0.1273 m.
    assert 5.0 - 1.7 < e.value.distance < 5.0 - 1.2


def test_active_limit_is_named() -> None:
    arm_ = robot("ur10")
    q = np.array([1.5, -1.2, 1.5, -0.7, 0.9, 0.4])
    place = pose(arm_, q)
    arm_.position_upper[0], arm_.position_lower[0] = 0.5, 0.0
    with pytest.raises(UnreachablePoseError, match=arm_.joint_names[0] + " at its upper limit 0.5"):
        solve_pose(arm_, place.translation, None, np.clip(q, None, [0.5, 9, 9, 9, 9, 9]))


def test_unreachable_orientation_is_distinguished() -> None:
    arm_ = robot("ur10")
    q = np.array([0.3, -1.2, 1.5, -0.7, 0.9, 0.4])
    place = pose(arm_, q)
    arm_.position_lower[3:], arm_.position_upper[3:] = q[3:] - 0.1, q[3:] + 0.1
    turned = rotation_from_rpy([0.0, 0.0, 2.5]) @ place.rotation
    with pytest.raises(UnreachablePoseError, match="position alone can be reached") as error:
        solve_pose(arm_, place.translation, turned, q)
    assert error.value.angle is not None
    assert error.value.angle > 0.01


def test_invalid_poses_are_refused() -> None:
    arm_ = robot("sample")
    with pytest.raises(ProblemError, match="position must hold 3 finite numbers"):
        solve_pose(arm_, [0.1, np.nan, 0.2])
    with pytest.raises(ProblemError, match="near must hold 6 finite numbers"):
        solve_pose(arm_, [0.1, 0.2, 0.3], None, [0.0, 1.0])


def test_rpy_turns_about_fixed_axes() -> None:
    roll, pitch, yaw = 0.3, -0.5, 1.1
    about = [pin.utils.rotate(axis, t) for axis, t in zip("xyz", (roll, pitch, yaw), strict=True)]
    assert rotation_from_rpy([roll, pitch, yaw]) == pytest.approx(about[2] @ about[1] @ about[0])


def test_an_arm_of_one_joint() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "only")
    arm_ = SimpleNamespace(
        name="one",
        model=model,
        tool=LinkFrame(1, np.array([1.0, 0.0, 0.0]), np.eye(3)),
        rigid_bodies=lambda: RigidBodies(model),
        prismatic=body_tree(model).prismatic,
        joint_names=("only",),
        position_lower=np.array([-np.inf]),
        position_upper=np.array([np.inf]),
    )
    found = solve_pose(arm_, [np.cos(0.7), np.sin(0.7), 0.0], None, [0.1])
    assert found == pytest.approx([0.7], abs=1e-9)
