"""Collisions: known distances of small arms, worst instant, reported scope."""

import json

import numpy as np
import pytest
from shaped_arms import load, write_stl
from small_arms import PLANAR, problem_text, write_robot

from stiffopt.certificate.assess import assess
from stiffopt.certificate.collisions import (
    COLLISION_LIMIT,
    describe_collision_scope,
    with_collisions,
)
from stiffopt.cli import run
from stiffopt.errors import InputError
from stiffopt.problem.files import load_problem
from stiffopt.result.trajectory import Trajectory
from stiffopt.robot.cell import Box, Cell, MeshObstacle, Plane
from stiffopt.robot.clearance import ClearanceModel

# Rods of 0.4 m with half a turn about y, so that they lie along x, as thin as 20 mm.
ROD = (
    '<collision><origin xyz="0.2 0 0" rpy="0 1.5707963267948966 0"/>'
    '<geometry><cylinder radius="0.01" length="0.4"/></geometry></collision>'
)
SHAPED = PLANAR.replace('<link name="upper">', f'<link name="upper">{ROD}').replace(
    '<link name="fore">', f'<link name="fore">{ROD}'
)
POST = (
    '<link name="base"><collision><origin xyz="-0.3 0 0"/>'
    '<geometry><box size="0.1 0.1 2"/></geometry></collision></link>'
)


def problem_of(folder, cell="", urdf=SHAPED, **pieces):
    write_robot(folder, urdf_text=urdf)
    path = folder / "problem.toml"
    path.write_text(problem_text(**pieces) + cell)
    return load_problem(path).problem


def swing(problem, start, end, duration=0.5):
    """Rest-to-rest motion on the straight line between joint positions."""
    start, end = np.array(start), np.array(end)
    nodes = np.outer([0.0, 1.0, -1.0, 0.0], 8.0 / duration**2 * (end - start))
    times = duration * np.array([0.0, 0.25, 0.75, 1.0])
    return assess(
        problem, Trajectory.piecewise_linear_acceleration(times, nodes, start, np.zeros(len(start)))
    )


def rows(motion):
    return {v.pair: v for v in motion.violations if v.limit == COLLISION_LIMIT}


def test_distances_of_known_poses(tmp_path):
    arm = load(tmp_path, SHAPED)
    cell = Cell(
        floor=-0.5,
        box=(Box(name="table", size=(0.2, 2.0, 0.2), position=(0.6, 0.0, -0.3)),),
        plane=(Plane(name="wall", point=(1.0, 0.0, 0.0), normal=(-2.0, 0.0, 0.0)),),
    )
    model = ClearanceModel(arm, cell)
    found = dict(zip(model.pairs, model.distances(np.zeros(2)), strict=True))
    # Both links along x at height 0, from 0 to 0.8 m.
    assert found["fore", "floor"] == pytest.approx(0.49, abs=1e-6)
    assert found["fore", "table"] == pytest.approx(0.19, abs=1e-6)
    assert found["fore", "wall"] == pytest.approx(0.2, abs=1e-6)
    # The upper one hanging: its end 0.4 m below, the fore one on along.
    hanging = dict(zip(model.pairs, model.distances(np.array([np.pi / 2, 0.0])), strict=True))
    assert hanging["fore", "floor"] == pytest.approx(-0.3, abs=1e-6)
    assert hanging["upper", "floor"] == pytest.approx(0.1, abs=1e-6)


def test_links_meet_each_other_but_not_their_neighbours(tmp_path):
    arm = load(tmp_path, SHAPED.replace('<link name="base"/>', POST))
    model = ClearanceModel(arm, Cell())
    assert model.pairs == [("base", "fore")]
    straight, folded = model.distances(np.zeros(2)), model.distances(np.array([0.0, np.pi]))
    # Folded back the fore link ends at the shoulder, 0.25 m before the post.
    assert straight[0] == pytest.approx(0.65, abs=1e-6)
    assert folded[0] == pytest.approx(0.25, abs=1e-6)
    assert ClearanceModel(arm, Cell(self_collision=False)).pairs == []


def test_meshes_of_links_and_of_the_cell(tmp_path):
    write_stl(tmp_path / "corner.stl", 100.0)
    cell = Cell(
        mesh=(MeshObstacle(name="jig", file="corner.stl", position=(0.7, -0.05, -0.3), scale=1e-3),)
    ).found_in(tmp_path)
    model = ClearanceModel(load(tmp_path, SHAPED), cell)
    found = dict(zip(model.pairs, model.distances(np.zeros(2)), strict=True))
    # The tetrahedron's top stands at -0.2 m.
    assert found["fore", "jig"] == pytest.approx(0.2, abs=0.005)


def test_two_of_many_missing_meshes_are_named(tmp_path):
    problem = problem_of(tmp_path)
    problem.clearance_model.missing = ("a.stl", "b.stl")
    assert describe_collision_scope(problem).endswith("Not found or no mesh: a.stl, b.stl.")
    problem.clearance_model.missing = tuple("abcde")
    assert describe_collision_scope(problem).endswith(
        "Not found or no mesh: a, b and 3 more shapes of the URDF."
    )


def test_the_worst_instant_of_a_motion_is_found(tmp_path):
    problem = problem_of(
        tmp_path,
        '[[cell.box]]\nname = "post"\nsize = ["2 mm", "2 mm", "2 mm"]\n'
        'position = ["0.3 m", "0 m", "0.2 m"]\n',
    )
    motion = swing(problem, [0.5, 0.0], [-1.8, 0.0])
    checked = with_collisions(problem, motion)
    every = np.array([problem.clearance_model.distances(q) for q in motion.position])
    for k, pair in enumerate(problem.clearance_model.pairs):
        if every[:, k].min() >= 0.0:
            continue
        row = rows(checked)[pair]
        assert row.distance == pytest.approx(every[:, k].min(), abs=2e-4)
        assert row.value > 0.005
        assert not checked.feasible(0.005)
        assert row.describe().startswith(f"the clearance of {' and '.join(pair)} at 0.")
        assert row.describe().endswith("mm deep")
    assert any(every.min(axis=0) < 0)


def test_thin_obstacle_between_coarse_instants_is_found(tmp_path):
    # 1 mm thick and passed at 2.4 m/s: the coarse instants lie 9 mm apart.
    problem = problem_of(
        tmp_path,
        '[[cell.box]]\nname = "sheet"\nsize = ["0.1 mm", "1 m", "0.1 mm"]\n'
        'position = ["0.79 m", "0 m", "0.0 m"]\n',
        urdf=SHAPED.replace('radius="0.01"', 'radius="0.0005"'),
    )
    motion = swing(problem, [0.5, 0.0], [-0.5, 0.0])
    assert rows(with_collisions(problem, motion))["fore", "sheet"].distance < 0


def test_clearance_is_a_limit_of_its_own(tmp_path):
    table = '[cell]\nfloor = "-0.5 m"\nclearance = "CLEAR"\n'
    for clear, kept in (("480 mm", True), ("495 mm", False)):
        problem = problem_of(tmp_path, table.replace("CLEAR", clear))
        motion = with_collisions(problem, swing(problem, [0.0, 0.0], [-0.2, 0.0]))
        row = rows(motion)["fore", "floor"] if not kept else next(iter(rows(motion).values()))
        assert (row.value <= 0) is kept
        assert row.distance == pytest.approx(0.49, abs=1e-6)


def test_a_solve_that_collides_fails_its_certificate(tmp_path, capsys):
    # The end lies 0.15 m below the floor.
    problem_of(
        tmp_path, '[cell]\nfloor = "-0.3 m"\n', method='intervals = 20\ncollisions = "check"'
    )
    out = tmp_path / "out"
    code = run(["solve", str(tmp_path / "problem.toml"), "--out", str(out), "--quiet"])
    printed = capsys.readouterr().out
    assert code == 3
    assert "fore and floor at" in printed
    document = json.loads((out / "result.json").read_text())
    assert document["status"] == "certificate_failed"
    (worst,) = [
        v for v in document["certificate"]["violations"] if v.get("pair") == ["fore", "floor"]
    ]
    assert worst["distance"] < -0.05
    page = (out / "report.html").read_text()
    assert "collision, fore and floor" in page
    assert "mm deep" in page
    assert not any(b["feasible"] for b in document["baselines"].values())
    assert run(["export", str(out), "--to", "csv"]) == 2


def test_unchecked_collisions_are_named(tmp_path):
    free = problem_of(tmp_path)
    assert describe_collision_scope(free) == (
        "Collisions were not checked: the arm with itself, the floor and the cell; describe "
        "the surroundings in [cell]."
    )
    bench = '[[cell.box]]\nname = "bench"\nsize = [1, 1, 0.1]\nposition = [0, 0, -2]\n'
    text = f'[cell]\nfloor = "-1 m"\n{bench}'
    checked = problem_of(tmp_path, text, urdf=SHAPED.replace('<link name="base"/>', POST))
    assert describe_collision_scope(checked) == (
        "Collisions were checked: the arm with itself (1 pairs of links), floor, bench."
    )
    bare = problem_of(tmp_path, text, urdf=PLANAR)
    assert "rods of a guessed radius: upper, fore" in describe_collision_scope(bare)
    assert "not checked: the arm with itself" in describe_collision_scope(bare)
    thick = problem_of(
        tmp_path, text.replace("[cell]\n", '[cell]\nlink_radius = "50 mm"\n'), urdf=PLANAR
    )
    assert "guessed" not in describe_collision_scope(thick)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[cell]\nclearance = "-1 mm"\n', "clearance"),
        ('[cell]\nflor = "0 m"\n', "flor"),
        ('[[cell.box]]\nname = "a"\nsize = [0, 1, 1]\nposition = [0, 0, 0]\n', "size"),
        ('[[cell.plane]]\nname = "a"\npoint = [0, 0, 0]\nnormal = [0, 0, 0]\n', "no direction"),
        ('[[cell.mesh]]\nname = "a"\nfile = "nowhere.stl"\n', "nowhere.stl"),
        (
            '[cell]\nfloor = 0\n[[cell.mesh]]\nname = "floor"\nfile = "nowhere.stl"\n',
            "named 'floor'",
        ),
    ],
)  # fmt: skip
def test_invalid_cells_are_refused(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        _ = problem_of(tmp_path, text).clearance_model
