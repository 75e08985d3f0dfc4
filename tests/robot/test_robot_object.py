"""Payload, tool and provenance of a robot."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from stiffopt.errors import RobotError
from stiffopt.robot.files import load_robot


def test_ur10_with_payload_matches_the_benchmark_arm():
    path = Path(__file__).parents[3] / "shared" / "benchmarks" / "ur10_5kg.urdf"
    if not path.is_file():
        pytest.skip("ur10_5kg.urdf is not beside the repository")
    reference = pin.buildModelFromUrdf(str(path))
    model = load_robot("ur10").with_payload(5.0, [0, 0, 0], [0.01, 0.01, 0.01]).model
    rng = np.random.default_rng(1)
    for _ in range(10):
        q, v, a = rng.normal(size=(3, 6)) * 2
        ours = pin.rnea(model, model.createData(), q, v, a)
        theirs = pin.rnea(reference, reference.createData(), q, v, a)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10 * np.abs(theirs).max())


@pytest.mark.parametrize("mass", [0.0, 2.0])
def test_payload_factor_may_be_zero(mass):
    robot = load_robot("ur10")
    centre, inertia = [0.01, 0.02, 0.03], [1e-3, 2e-3, 2.5e-3]
    times = robot.with_payload(mass, centre, inertia).with_payload_times(1.5)
    truth = robot.with_payload(1.5 * mass, centre, 1.5 * np.array(inertia))
    for found, true in zip(times.model.inertias, truth.model.inertias, strict=True):
        np.testing.assert_allclose(found.inertia, true.inertia, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(found.lever, true.lever, rtol=1e-12, atol=1e-15)
    # Nor need the link weigh anything that carries it.
    bare = load_robot("ur10")
    bare.model.inertias[6] = pin.Inertia.Zero()
    empty = bare.with_payload(2.0, centre, inertia).with_payload_times(0.0).model.inertias[6]
    np.testing.assert_allclose(empty.toDynamicParameters(), 0.0, atol=1e-12)


def test_ur10_tool_is_in_the_frame_of_joint_6():
    robot = load_robot("ur10")
    np.testing.assert_allclose(robot.tool.offset, [0, 0.0922, 0], atol=1e-12)
    assert robot.tool.joint == 6
    # z of the flange points outwards.
    np.testing.assert_allclose(robot.flange.rotation[:, 2], [0, 1, 0], atol=1e-12)


def test_payload_is_at_the_flange_of_a_copy():
    robot = load_robot("er3a_c60")
    loaded = robot.with_payload(2.0, [0.01, 0.02, 0.03], [1e-3, 2e-3, 2.5e-3])
    assert robot.model.inertias[6].mass == pytest.approx(0.137)
    added = loaded.model.inertias[6]
    assert added.mass == pytest.approx(2.137)
    expected = (0.137 * np.array([0, 0, 0.06]) + 2.0 * np.array([0.01, 0.02, 0.1085])) / 2.137
    np.testing.assert_allclose(added.lever, expected, atol=1e-12)
    point = robot.with_payload(1.0)
    assert point.model.inertias[6].mass == pytest.approx(1.137)


def test_tool_is_resolved_to_its_joint():
    robot = load_robot("er3a_c60")
    same = robot.with_tool("flange", [0, 0, 0])
    np.testing.assert_allclose(same.tool.offset, robot.tool.offset, atol=1e-15)
    longer = robot.with_tool(None, [0, 0, 0.1])
    assert longer.tool.link == "link_6"
    np.testing.assert_allclose(longer.tool.offset, [0, 0, 0.1])
    elbow = robot.with_tool("link_3")
    assert elbow.tool.joint == 3
    turned = robot.with_tool("flange", None, [np.pi, 0, 0])
    np.testing.assert_allclose(turned.tool.rotation, np.diag([1, -1, -1]), atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((-1.0,), "mass = -1"),
        ((float("nan"),), "finite"),
        ((1.0, [0, 0]), "com of 3"),
        ((1.0, [0, 0, 0], [1, 1, 3]), "none above the sum of the other two"),
        ((1.0, [0, 0, 0], [-1, 1, 1]), "none may be below 0"),
    ],
)
def test_impossible_payloads_are_refused(arguments, text):
    with pytest.raises(RobotError) as error:
        load_robot("ur10").with_payload(*arguments)
    assert text in str(error.value)


def test_impossible_tools_are_refused():
    with pytest.raises(RobotError, match="Did you mean 'link_6'"):
        load_robot("er3a_c60").with_tool("link6")
    with pytest.raises(RobotError, match="does not move"):
        load_robot("er3a_c60").with_tool("base_link")
    with pytest.raises(RobotError, match="3 finite numbers"):
        load_robot("er3a_c60").with_tool("link_6", [0, 0])


def test_estimated_numbers_are_listed():
    rows = load_robot("er3a_c60").estimated()
    elements = {(r.joint, r.element) for r in rows}
    assert ("joint_1", "motor_key") in elements
    assert ("joint_2", "reducer") in elements
    flange = [r for r in rows if r.element == "flexspline_flange" and r.joint == "joint_1"]
    assert {r.key for r in flange} == {
        "inner_radius",
        "outer_radius",
        "preload",
        "surface",
        "roughness",
    }
