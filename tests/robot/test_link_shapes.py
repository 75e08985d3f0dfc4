"""Shapes of links: read from URDFs, found beside them, placed in the frames of the joints."""

from dataclasses import replace

import coal
import numpy as np
import pytest
from shaped_arms import BOX, MESH, load, with_shapes, write_stl
from small_arms import PLANAR

from stiffopt.errors import InputFileError, RobotError
from stiffopt.robot.body_tree import arm_reach, link_capsules, mounting_distance
from stiffopt.robot.link_shapes import LinkShape, _load_mesh, convex_hull, mesh_triangles


def test_shapes_are_in_the_frame_of_their_joint(tmp_path):
    arm = load(tmp_path, with_shapes("fore", BOX))
    (placed,) = arm.joint_shapes("visual")
    assert (placed.joint, placed.shape.kind, placed.shape.size) == (2, "box", (0.1, 0.4, 0.1))
    np.testing.assert_allclose(placed.offset, [0.2, 0.0, 0.0])
    np.testing.assert_allclose(placed.rotation @ [0, 1, 0], [-1, 0, 0], atol=1e-12)
    assert arm.joint_shapes("collision") == []


def test_shapes_of_fixed_links_belong_to_the_link_before(tmp_path):
    tip = '<link name="tip"><visual><geometry><sphere radius="0.05"/></geometry></visual></link>'
    arm = load(tmp_path, PLANAR.replace('<link name="tip"/>', tip))
    (placed,) = arm.joint_shapes("visual")
    assert placed.joint == 2
    np.testing.assert_allclose(placed.offset, [0.4, 0.0, 0.0])
    (locked,) = arm.with_joints_locked(["elbow"]).joint_shapes("visual")
    assert locked.joint == 1
    np.testing.assert_allclose(locked.offset, [0.8, 0.0, 0.0])


@pytest.mark.parametrize("name", ["package://my_arm/meshes/link.stl", "../meshes/link.stl"])
def test_meshes_are_found_and_scaled(tmp_path, name):
    write_stl(tmp_path / "my_arm" / "meshes" / "link.stl")
    folder = tmp_path / "my_arm" / "urdf"
    folder.mkdir()
    arm = load(folder, with_shapes("upper", MESH.format(purpose="collision", name=name)))
    (shape,) = arm.shapes
    assert shape.known
    vertices, corners = mesh_triangles(shape)
    assert len(corners) == 4
    np.testing.assert_allclose(np.ptp(vertices, axis=0), 0.1, rtol=1e-6)


def test_meshes_of_ros_packages(tmp_path, monkeypatch):
    write_stl(tmp_path / "elsewhere" / "share" / "my_arm" / "link.stl")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "elsewhere"))
    arm = load(
        tmp_path,
        with_shapes("upper", MESH.format(purpose="visual", name="package://my_arm/link.stl")),
    )
    assert arm.shapes[0].known


@pytest.mark.parametrize("name", ["package://other/link.stl", "package://[", "x" * 5000, "", "."])
def test_missing_mesh_is_not_known(tmp_path, name):
    arm = load(tmp_path, with_shapes("upper", MESH.format(purpose="visual", name=name)))
    assert not arm.shapes[0].known
    assert arm.shapes[0].name == name


def test_file_that_is_no_mesh_is_refused(tmp_path):
    (tmp_path / "link.stl").write_text("nothing")
    arm = load(tmp_path, with_shapes("upper", MESH.format(purpose="visual", name="link.stl")))
    with pytest.raises(InputFileError, match="cannot be read as a mesh"):
        mesh_triangles(arm.shapes[0])


@pytest.mark.parametrize("size", ["0.1 0.4", "0.1 0.4 -1", "a b c"])
def test_impossible_sizes_are_refused(tmp_path, size):
    with pytest.raises(RobotError, match="visual box size"):
        load(tmp_path, with_shapes("fore", BOX.replace("0.1 0.4 0.1", size)))


def test_path_of_a_mesh_does_not_change_the_hash(tmp_path):
    from stiffopt.result.provenance import inputs_hash

    one, two = (
        LinkShape(link="a", purpose="visual", kind="mesh", size=(1.0,), offset=np.zeros(3),
                  rotation=np.eye(3), digest=digest, file=tmp_path / name)
        for name, digest in (("one.stl", "1"), ("two.stl", "1"))
    )  # fmt: skip
    assert inputs_hash(one) == inputs_hash(two)
    other = LinkShape(link="a", purpose="visual", kind="mesh", size=(1.0,), offset=np.zeros(3),
                      rotation=np.eye(3), digest="2")  # fmt: skip
    assert inputs_hash(one) != inputs_hash(other)


def test_capsules_reach_from_base_to_tool(tmp_path):
    arm = load(tmp_path, PLANAR)
    # The shoulder lies in the base's origin: no rod leads to it.
    rods = link_capsules(arm.tree, arm.tool)
    assert [rod.joint for rod in rods] == [1, 2]
    np.testing.assert_allclose(rods[1].end, [0.4, 0.0, 0.0])
    assert arm_reach(arm.tree, arm.tool) == pytest.approx(0.4)
    assert rods[0].radius > rods[1].radius > 0


def test_distant_mounting_is_no_link_of_the_arm(tmp_path):
    arm = load(tmp_path, PLANAR)
    first, *others = arm.tree.bodies
    hung = replace(
        arm.tree, bodies=(replace(first, translation=np.array([0.0, 0.0, 2.0])), *others)
    )
    assert mounting_distance(arm.tree) == 0.0
    assert mounting_distance(hung) == 2.0
    plain, below = link_capsules(arm.tree, arm.tool), link_capsules(hung, arm.tool)
    assert [rod.joint for rod in below] == [rod.joint for rod in plain]
    assert [rod.radius for rod in below] == pytest.approx([rod.radius for rod in plain])


def test_hull_of_a_disc_with_a_rim_of_many_points(tmp_path):
    """Qhull triangulates its flat faces from one vertex, with more neighbours than coal allows."""
    angle = 2.0 * np.pi * np.arange(600) / 600
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    vertices = np.concatenate([rim, rim + np.array([0.0, 0.0, 0.2])])
    sides = [(k, (k + 1) % 600, 600 + k) for k in range(600)]
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in sides]
    (tmp_path / "disc.obj").write_text("\n".join(lines))
    mesh = _load_mesh(tmp_path / "disc.obj", np.ones(3), coal.NODE_TYPE.BV_AABB)
    hull = convex_hull(mesh, None)
    ball, here = coal.Sphere(0.1), coal.Transform3s()
    beside = coal.Transform3s(np.eye(3), np.array([1.5, 0.0, 0.1]))
    found = coal.DistanceResult()
    coal.distance(hull, here, ball, beside, coal.DistanceRequest(), found)
    assert found.min_distance == pytest.approx(0.4, abs=1e-4)
