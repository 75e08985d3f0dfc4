"""Bending links: beam formulas, complementary energy along the beam, finite element matrices."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from stiffopt.drivetrain import catalogue
from stiffopt.dynamics.bearings import dynamic_bearing_displacements
from stiffopt.errors import InputError, InputFileError
from stiffopt.robot.bearings import (
    bearing_deflections,
    dynamic_bearing_deflections,
    with_bearing_joints,
)
from stiffopt.robot.files import load_robot
from stiffopt.robot.joint_load import complete_axes, joint_frames, joint_wrenches
from stiffopt.robot.link_beam import LinkBeam

UPPER_ARM = [
    'joint[2].beam.width="90 mm"',
    'joint[2].beam.height="120 mm"',
    'joint[2].beam.wall="4 mm"',
]
TUBE = LinkBeam(diameter=0.08, wall=0.004, material="steel")
STEEL = catalogue.material("steel")


def end_compliance(beam: LinkBeam, end: np.ndarray) -> np.ndarray:
    """Compliance (6, 6) of the beam's end from its springs, for a joint about z."""
    axis = np.array([0.0, 0.0, 1.0])
    mount, turn = beam.mount(axis, end, 1), np.kron(np.eye(2), complete_axes(axis))
    end = turn[:3, :3].T @ end
    found = np.zeros((6, 6))
    for k in range(6):
        force, moment = np.split(np.eye(6)[k], 2)
        about = moment + np.cross(end - mount.place, force)
        loads = mount.compliance * np.concatenate([mount.axes.T @ force, mount.axes.T @ about])
        moved, turned = mount.axes @ loads[:3], mount.axes @ loads[3:]
        found[:3, k] = moved + np.cross(turned, end - mount.place)
        found[3:, k] = turned
    return np.asarray(turn @ found @ turn.T)


def test_tube_bends_as_a_cantilever() -> None:
    length, modulus = 0.4, STEEL.modulus
    second = np.pi / 64.0 * (0.08**4 - 0.072**4)
    area = np.pi / 4.0 * (0.08**2 - 0.072**2)
    at_end = end_compliance(TUBE, np.array([length, 0.0, 0.0]))
    shear = 1.2 * length / (STEEL.shear_modulus * area)
    assert at_end[2, 2] == pytest.approx(length**3 / (3.0 * modulus * second) + shear)
    assert at_end[0, 0] == pytest.approx(length / (modulus * area))
    assert at_end[4, 2] == pytest.approx(-(length**2) / (2.0 * modulus * second))
    assert at_end[3, 3] == pytest.approx(length / (STEEL.shear_modulus * 2.0 * second))


def test_height_of_a_box_lies_along_the_axis() -> None:
    box = LinkBeam(width=0.05, height=0.15, wall=0.005)
    at_end = end_compliance(box, np.array([0.5, 0.0, 0.0]))
    assert at_end[1, 1] > 3.0 * at_end[2, 2]


def test_deflection_is_the_slope_of_the_complementary_energy() -> None:
    """Castigliano, with the wrench at every section of the beam."""
    robot = load_robot("er3a_c60", changes=UPPER_ARM).with_payload(2.0, (0.0, 0.02, 0.05))
    pose = np.array([[0.3, -0.4, 0.5, 0.2, 0.7, -0.1]])
    body, following = robot.tree.bodies[1], robot.tree.bodies[2]
    end = complete_axes(body.axis).T @ following.translation
    length, along = np.linalg.norm(end), end / np.linalg.norm(end)
    up = np.array([0.0, 0.0, 1.0]) - along[2] * along
    up /= np.linalg.norm(up)
    axes = np.column_stack([np.cross(up, along), up, along])
    material = catalogue.material("aluminium")
    outer, inner = np.array([0.09, 0.12]), np.array([0.082, 0.112])
    area = outer.prod() - inner.prod()
    second = (outer**3 * outer[::-1] - inner**3 * inner[::-1]) / 12.0
    middle = (outer + inner) / 2.0
    torsion = 4.0 * middle.prod() ** 2 * 0.004 / (2.0 * middle.sum())
    rigidity = np.array(
        [
            *2 * (5.0 / 6.0 * material.shear_modulus * area,),
            material.modulus * area,
            *(material.modulus * second[::-1]),
            material.shear_modulus * torsion,
        ]
    )
    points, weights = np.polynomial.legendre.leggauss(4)

    def energy(force: np.ndarray) -> float:
        still = np.zeros_like(pose)
        before, after = joint_wrenches(robot, pose, still, still, force)[0, 1:3]
        axes_of, _ = joint_frames(robot, pose)
        # Of joint 3 in axes of the link, and with the force and moment of half of the link.
        turn = axes_of[0, 1].T @ axes_of[0, 2]
        moment = turn @ after[3:] + np.cross(end, turn @ after[:3])
        wrench = 0.5 * (before + np.concatenate([turn @ after[:3], moment]))
        total = 0.0
        for point, weight in zip(points, weights, strict=True):
            place = 0.5 * (1.0 + point) * end
            about = wrench[3:] - np.cross(place, wrench[:3])
            own = np.concatenate([axes.T @ wrench[:3], axes.T @ about])
            total += 0.25 * weight * length * float(np.sum(own**2 / rigidity))
        return total

    force = np.array([20.0, -10.0, 5.0])
    slope = [(energy(force + d) - energy(force - d)) / 2.0 for d in np.eye(3)]
    found = bearing_deflections(robot, pose, force=force)[0]
    np.testing.assert_allclose(found[1, :3], slope, rtol=1e-9)
    assert not np.delete(found, 1, axis=0).any()


def test_symbolic_displacement_equals_the_numeric_one() -> None:
    changes = [*UPPER_ARM, 'joint[2].bearing.catalogue="csf_2uh_25"', 'joint[3].beam.wall="3 mm"']
    changes += ['joint[3].beam.diameter="60 mm"']
    robot = load_robot("er3a_c60", changes=changes).with_payload(2.0, (0.0, 0.02, 0.05))
    motion = [ca.SX.sym(name, robot.n) for name in "qva"]
    found = dynamic_bearing_displacements(robot, *motion)
    assert sorted(found) == [1, 2]
    values = ca.Function("links", motion, [ca.horzcat(*found.values())])
    random = np.random.default_rng(5)
    own = [random.uniform(-1.0, 1.0, robot.n) * size for size in (1.0, 3.0, 20.0)]
    expected = dynamic_bearing_deflections(robot, *(x[None] for x in own))[0, :, :3]
    np.testing.assert_allclose(
        np.array(values(*own)).T, expected[sorted(found)], rtol=1e-9, atol=1e-15
    )


def test_springs_of_the_simulation_are_those_of_the_beam() -> None:
    """Small rotations of its joints against the compliance of the deflection."""
    robot = load_robot("er3a_c60", changes=[*UPPER_ARM, 'joint[2].bearing.catalogue="csf_2uh_25"'])
    arm, stiffness = with_bearing_joints(robot)
    pose, force = np.array([0.3, -0.4, 0.5, 0.2, 0.7, -0.1]), np.array([40.0, 30.0, -20.0])
    driven = stiffness == 0.0
    assert np.sum(~driven) == np.sum(robot.mounts[1][0].compliance > 0.0) + 6
    q = np.zeros(arm.n)
    q[driven] = pose
    body = arm.rigid_bodies()
    jacobian = body.jacobian(arm.tool, q)[:, ~driven]
    away = jacobian @ (jacobian[:3].T @ force / stiffness[~driven])
    still = np.zeros((1, 6))
    both = bearing_deflections(robot, pose[None], still, still, force).sum(axis=1)[0]
    weight = bearing_deflections(robot, pose[None]).sum(axis=1)[0]
    np.testing.assert_allclose(away, both - weight, rtol=1e-9, atol=1e-15)


def test_a_finite_element_matrix_gives_the_same_springs() -> None:
    end = np.array([0.1, 0.3, 0.05])
    box = LinkBeam(width=0.08, height=0.1, wall=0.005)
    expected = end_compliance(box, end)
    matrix = tuple(map(tuple, np.linalg.inv(expected).tolist()))
    np.testing.assert_allclose(
        end_compliance(LinkBeam(stiffness=matrix), end), expected, rtol=1e-6, atol=1e-15
    )


def test_a_matrix_that_stays_coupled_is_refused() -> None:
    compliance = np.diag([1e-8] * 3 + [1e-6] * 3)
    compliance[0, 3] = compliance[3, 0] = 5e-8  # turns as it is pulled
    with pytest.raises(InputError, match="coupled by"):
        LinkBeam(stiffness=tuple(map(tuple, np.linalg.inv(compliance).tolist())))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (['joint[2].beam.diameter="80 mm"'], "wall"),
        (['joint[2].beam.diameter="80 mm"', 'joint[2].beam.wall="50 mm"'], "up to half"),
        (['joint[2].beam.wall="5 mm"'], "diameter and wall"),
        (['joint[6].beam.diameter="80 mm"', 'joint[6].beam.wall="5 mm"'], "no joint follows"),
        (["joint[2].beam.stiffness=[[1, 2], [3, 4]]"], "beam.stiffness"),
    ],
)
def test_incomplete_beams_are_refused(changes: list[str], told: str) -> None:
    with pytest.raises(InputFileError, match=told) as caught:
        load_robot("er3a_c60", changes=changes)
    assert "beam" in str(caught.value)


def test_a_link_up_to_a_locked_joint_carries_the_next_one() -> None:
    changes = [*UPPER_ARM, 'joint[3].beam.diameter="60 mm"', 'joint[3].beam.wall="3 mm"']
    robot = load_robot("er3a_c60", changes=changes)
    locked = robot.with_joints_locked(["joint_3"])
    assert [each and each.carries for each in locked.links] == [None, 2, None, None, None]
    last = robot.with_joints_locked(["joint_4", "joint_5", "joint_6"])
    assert [each and each.carries for each in last.links] == [None, 2, None]
