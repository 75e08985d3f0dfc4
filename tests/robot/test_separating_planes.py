"""Planes between solids: as far from each other as coal measures, and kept all along a step."""

import numpy as np
import pytest
from shaped_arms import load, write_stl
from small_arms import SPATIAL

from stiffopt.dynamics.kinematics import height_over_plane
from stiffopt.robot.cell import Box, Cell, MeshObstacle, Plane
from stiffopt.robot.clearance import ClearanceModel
from stiffopt.robot.separating_planes import SeparatingPlanes

POST = '<geometry><box size="0.08 0.08 1.2"/></geometry>'
UPPER = '<geometry><cylinder radius="0.03" length="0.3"/></geometry>'
HULL = '<geometry><mesh filename="hull.stl" scale="0.002 0.001 0.001"/></geometry>'
BALL = '<geometry><sphere radius="0.05"/></geometry>'


@pytest.fixture
def model(tmp_path):
    text = SPATIAL
    for link, shape, place in (
        ("post", POST, "-0.3 0 0"),
        ("upper", UPPER, "0.2 0 0.01"),
        ("fore", HULL, "0.2 0.02 0"),
        ("fore", BALL, "0.4 0 0"),
    ):
        text = text.replace(
            f'<link name="{link}">',
            f'<link name="{link}"><collision><origin xyz="{place}" rpy="0.3 0.9 0"/>'
            f"{shape}</collision>",
        )
    write_stl(tmp_path / "hull.stl", 100.0)
    write_stl(tmp_path / "jig.stl", 150.0)
    cell = Cell(
        floor=-0.7,
        box=(Box(name="box", size=(0.2, 0.3, 0.2), position=(0.5, 0.5, 0.3), rpy=(0.1, 0.2, 0)),),
        plane=(Plane(name="wall", point=(1.2, 0, 0), normal=(-1, 0.2, 0.1)),),
        mesh=(MeshObstacle(name="jig", file="jig.stl", position=(0.4, -0.7, 0.4), scale=1e-3),),
    ).found_in(tmp_path)
    return load(tmp_path, text), cell


def poses(robot, count, seed=0):
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (count, robot.n))


def test_plane_distance_equals_distance_by_coal(model):
    robot, cell = model
    clear = ClearanceModel(robot, cell)
    separating = SeparatingPlanes(clear)
    seen = set()
    for q in poses(robot, 20):
        distances = clear.couple_distances(q)
        placed = clear.placements(q)
        for k, distance in enumerate(distances):
            if distance > 1e-3:
                # The rim of a round face gives the direction nearly.
                plane = separating.plane(k, [placed])
                assert plane.distance <= distance + 1e-6
                assert plane.distance == pytest.approx(distance, rel=0.01, abs=3e-3)
                assert np.linalg.norm(plane.normal) == pytest.approx(1.0)
                seen.add(clear.pairs[clear.pair_of[k]])
    assert {("upper", "box"), ("fore", "box"), ("fore", "jig"), ("fore", "wall")} <= seen
    assert ("post", "fore") in seen


def test_plane_holds_in_all_poses_of_a_step(model):
    robot, cell = model
    clear = ClearanceModel(robot, cell)
    separating = SeparatingPlanes(clear)
    for q in poses(robot, 15, seed=1):
        other = q + np.random.default_rng(2).normal(scale=0.05, size=robot.n)
        ends = [clear.placements(q), clear.placements(other)]
        between = clear.couple_distances(0.5 * (q + other))
        for k in range(len(clear.couples)):
            plane = separating.plane(k, ends)
            # Between the ends links bend away by less than (step^2 / 8) times the arm.
            assert between[k] > plane.distance - 2e-3 or plane.distance < 0.0
            assert plane.distance <= separating.plane(k, ends[:1]).distance + 1e-4


def test_constraint_rows_are_heights_over_the_plane(model):
    robot, cell = model
    clear = ClearanceModel(robot, cell)
    separating = SeparatingPlanes(clear)
    for q in poses(robot, 5, seed=3):
        placed = clear.placements(q)
        for k, (a, b) in enumerate(clear.couples):
            plane = separating.plane(k, [placed])
            row = height_over_plane(robot.tree, clear.solids[a].joint, clear.solids[b].joint)
            near = plane.near
            heights = [
                float(row(q, np.r_[centre, axis, radius, plane.normal, plane.height]))
                for centre, axis, radius in zip(near.centre, near.axis, near.radius, strict=True)
            ]
            assert min(heights) == pytest.approx(plane.distance, abs=1e-4)
