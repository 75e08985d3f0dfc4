"""The scene of a motion: kinematics against pinocchio, sums of shares, meshes."""

import json
from base64 import b64decode

import numpy as np
import pytest
import small_arms
from shaped_arms import MESH, load, with_shapes, write_stl
from small_arms import write_problem

from stiffopt.certificate.assess import assess
from stiffopt.problem.files import load_problem
from stiffopt.report.scene.document import compact_mesh, edges_around, scene_document, scene_json
from stiffopt.report.scene.poses import Poses, poses_along
from stiffopt.report.scene.still import still_figure
from stiffopt.result.trajectory import Trajectory
from stiffopt.robot.batched_kinematics import tool_jacobians
from stiffopt.robot.cell import Box, Cell, MeshObstacle, Plane
from stiffopt.robot.link_shapes import LinkShape


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """A problem with a tool force, and a motion from rest to rest."""
    folder = tmp_path_factory.mktemp("scene")
    path = write_problem(folder, minimise='objective = "dynamic_deflection"')
    text = path.read_text()
    path.write_text(f'{text}\n[tool]\nlink = "tip"\nprocess_force = [0.0, 0.0, -20.0]\n')
    problem = load_problem(path).problem
    start, end = problem.start.joints, problem.end.joints
    times, rate = np.array([0.0, 0.25, 0.75, 1.0]) / 2, 4.0
    nodes = np.outer([0.0, rate, -rate, 0.0], end - start)
    motion = Trajectory.piecewise_linear_acceleration(times, nodes, start, np.zeros_like(start))
    return problem, assess(problem, motion)


def test_windup_gives_the_deflection_and_shares_add_up(moved):
    problem, motion = moved
    poses = poses_along(problem, motion)
    assert set(poses.bend) == {"dynamic", "static", "process", "total"}
    _, jacobian = tool_jacobians(problem.robot.tree, problem.robot.tool, poses.position)
    for part, bend in poses.bend.items():
        vectors = np.einsum("kij,kj->ki", jacobian, bend)
        size = np.linalg.norm(vectors, axis=1)
        np.testing.assert_allclose(size, poses.deflection[part], rtol=1e-9, atol=1e-15)
        moving = size > 1e-9
        np.testing.assert_allclose(poses.share[part][moving].sum(axis=1), 1.0, rtol=1e-9)
    largest = np.linalg.norm(motion.deflection["dynamic"], axis=1).max()
    assert poses.deflection["dynamic"].max() == largest


def test_scene_document_is_safe_in_a_script_element(moved):
    problem, motion = moved
    document = scene_document(problem.robot, {"</script><b>": poses_along(problem, motion)}, "x", 5)
    text = scene_json(document)
    assert "<" not in text
    back = json.loads(text)
    assert back["motions"][0]["name"] == "</script><b>"
    assert back["part"] == "dynamic"
    assert {shape["kind"] for shape in back["shapes"]} == {"capsule"}


def test_scene_has_the_boxes_of_the_cell(moved):
    problem, motion = moved
    box = Box(name="table", size=(0.2, 0.4, 0.1), position=(0.5, 0.1, -0.2), rpy=(0.0, 0.0, 0.5))
    poses = {"own": poses_along(problem, motion)}
    (shown,) = scene_document(problem.robot, poses, "", 1.0, Cell(box=(box,)))["around"]
    assert shown["size"] == [0.2, 0.4, 0.1]
    wall = Plane(name="wall", point=(0.0, -1.0, 0.3), normal=(0.0, 2.0, 0.0))
    around = scene_document(problem.robot, poses, "", 1.0, Cell(floor=-0.2, plane=(wall,)))[
        "around"
    ]
    assert [each["name"] for each in around] == ["wall", "floor"]
    for each, normal, distance in zip(around, ([0, 1, 0], [0, 0, 1]), (-1.0, -0.2), strict=True):
        turn = np.array(each["rotation"])
        np.testing.assert_allclose(turn[:, 2], normal, atol=1e-12)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        face = np.array(each["offset"]) + 0.5 * each["size"][2] * turn[:, 2]
        assert face @ normal == pytest.approx(distance)
    edges = edges_around(Cell(box=(box,)))
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    assert sorted(lengths) == pytest.approx([0.1] * 4 + [0.2] * 4 + [0.4] * 4)
    assert edges.mean(axis=(0, 1)) == pytest.approx(box.position)
    assert scene_document(problem.robot, poses, "", 1.0)["around"] == []


def test_missing_cell_mesh_is_omitted(moved, tmp_path):
    problem, motion = moved
    grid_mesh(tmp_path / "table.obj", 4)
    poses = {"own": poses_along(problem, motion)}
    files = [
        MeshObstacle(name=name, file=str(tmp_path / name)) for name in ("table.obj", "lost.obj")
    ]
    (shown,) = scene_document(problem.robot, poses, "", 1.0, Cell(mesh=tuple(files)))["around"]
    assert (shown["kind"], shown["name"]) == ("mesh", "table.obj")
    assert shown["triangles"]


def grid_mesh(path, cells):
    """A wavy square of 2 cells^2 triangles, as OBJ."""
    x, y = np.meshgrid(*[np.linspace(0, 1, cells + 1)] * 2, indexing="ij")
    points = np.stack([x, y, 0.1 * np.sin(9 * x) * np.cos(9 * y)], axis=-1).reshape(-1, 3)
    lines = [f"v {a:.6f} {b:.6f} {c:.6f}" for a, b, c in points]
    for i in range(cells):
        for k in range(cells):
            a = i * (cells + 1) + k + 1
            lines += [f"f {a} {a + 1} {a + cells + 2}", f"f {a} {a + cells + 2} {a + cells + 1}"]
    path.write_text("\n".join(lines))


def test_fine_meshes_are_coarsened_in_place(tmp_path):
    grid_mesh(tmp_path / "wave.obj", 60)
    shape = LinkShape(
        link="a",
        purpose="visual",
        kind="mesh",
        size=(1.0, 1.0, 1.0),
        offset=np.zeros(3),
        rotation=np.eye(3),
        file=tmp_path / "wave.obj",
    )
    document = compact_mesh(shape, most=2000)
    cells = np.frombuffer(b64decode(document["vertices"]), "<u2").reshape(-1, 3)
    corners = np.frombuffer(b64decode(document["triangles"]), "<u2").reshape(-1, 3)
    assert 500 < len(corners) <= 2000
    assert corners.max() == len(cells) - 1
    points = document["origin"] + document["step"] * cells
    height = 0.1 * np.sin(9 * points[:, 0]) * np.cos(9 * points[:, 1])
    assert np.abs(points[:, 2] - height).max() < 2 * document["step"]
    whole = compact_mesh(shape, most=100_000)
    assert len(b64decode(whole["triangles"])) == 6 * 7200


def test_unreadable_mesh_is_replaced_by_a_capsule(tmp_path):
    write_stl(tmp_path / "good.stl")
    (tmp_path / "bad.stl").write_text("nothing")
    text = with_shapes("upper", MESH.format(purpose="visual", name="good.stl"))
    text = text.replace(
        '<link name="fore">', f'<link name="fore">{MESH.format(purpose="visual", name="bad.stl")}'
    )
    arm = load(tmp_path, text)
    shapes = scene_document(arm, {"rest": _resting(arm)}, "", 1.0)["shapes"]
    assert [(shape["joint"], shape["kind"]) for shape in shapes] == [(1, "mesh"), (2, "capsule")]


@pytest.mark.parametrize("centre", [0.0, 0.2])
def test_still_of_an_arm_without_extent(tmp_path, centre):
    """Joint and tool coincide, perhaps the centre of mass too."""
    turn = small_arms._turn("swivel", "base", "upper", 0.0, axis="0 0 1")
    text = small_arms.urdf([turn], [("upper", centre, 2.0)])
    arm = load(tmp_path, text.replace('<origin xyz="0.4 0 0"/>', ""))
    (axes,) = still_figure(arm.tree, arm.tool, [_resting(arm)], "", 1.0).axes
    low, high = axes.get_xlim()
    assert 0.05 < high - low < 2.0
    assert low <= 0.0 <= high


def test_still_contains_every_path(moved):
    """Also with a long baseline path and a large magnified deflection."""
    problem, motion = moved
    own = poses_along(problem, motion)
    far = Poses(own.time, own.position + np.sin(np.linspace(0, np.pi, len(own.time)))[:, None],
                {}, {}, {})  # fmt: skip
    robot = problem.robot
    (axes,) = still_figure(robot.tree, robot.tool, [own, far], "dynamic", 500.0).axes
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    for line in axes.lines:
        x, y = line.get_data()
        assert left <= np.min(x) <= np.max(x) <= right
        assert low <= np.min(y) <= np.max(y) <= high


def _resting(arm):
    return Poses(np.array([0.0, 1.0]), np.zeros((2, arm.n)), {}, {}, {})
