"""Collision avoidance: optima known in closed form, infeasible cases, interruptions."""

import re
from dataclasses import replace

import numpy as np
import pytest
from gantry_arm import CLEARANCE, HALF, ROUND, TOP, write_gantry
from gripper_arm import write_gripper_urdf
from small_arms import PLANAR, problem_text, write_robot

from stiffopt import solve
from stiffopt.certificate.collisions import COLLISION_LIMIT
from stiffopt.cli import run as command
from stiffopt.errors import ProblemError
from stiffopt.path import path_search
from stiffopt.path.path_search import FreeSpace
from stiffopt.problem.files import load_problem
from stiffopt.problem.resolve import resolve
from stiffopt.solver import collision_avoidance, programme
from stiffopt.solver.family import ProblemFamily
from stiffopt.solver.solve import solve_with_state

WALLS = """[[cell.box]]
name = "wall"
size = [0.02, 4.0, 0.4]
position = [0.2, 0.0, 0.0]
"""


# Rods of 0.4 m with half a turn about y, so that they lie along x.
ROD = (
    '<collision><origin xyz="0.2 0 0" rpy="0 1.5707963267948966 0"/>'
    '<geometry><cylinder radius="0.01" length="0.4"/></geometry></collision>'
)


def gantry_problem(folder, **pieces):
    return load_problem(write_gantry(folder, **pieces)).problem


def nearest(problem, motion):
    positions = motion.position if motion.link is None else motion.link
    return min(float(problem.clearance_model.distances(q).min()) for q in positions[::10])


def least_force(top):
    """Integral of the squared acceleration past a point at height `top`, in 1 s from rest to rest.

    Cubics in both halves, at rest along y in the middle. Where they bend less than the post they
    touch it at its top alone.
    """
    bend = 24.0 * top / (3.0 * HALF) ** 2
    assert bend < 1.0 / ROUND
    return (12.0 * (2.0 * HALF) ** 2 + 192.0 * top**2) / 10.0**2


@pytest.mark.parametrize(("lowest", "top"), [(-0.05, TOP), (-1.0, 2.0 * ROUND - TOP)])
def test_least_force_around_a_post_is_the_exact_one(tmp_path, lowest, top):
    # The way below is shorter; where the slide does not go there, the one above is taken.
    problem = gantry_problem(tmp_path, lowest=lowest)
    found = solve(problem)
    assert found.status == "optimal"
    # Chords of 40 steps around the post keep up to 0.2 mm away from it.
    assert found.objective.value == pytest.approx(least_force(top), rel=1.5e-3)
    assert found.objective.value > least_force(top) * (1 - 1e-5)
    assert CLEARANCE - 1e-5 < nearest(problem, found.assessment) < CLEARANCE + 3e-4
    assert not any(
        v.value > 0.005 for v in found.assessment.violations if v.limit == COLLISION_LIMIT
    )
    # The straight motions collide; it is compared with one along the path it began with.
    assert [name for name, each in found.baselines.items() if each.feasible] == ["detour"]
    assert nearest(problem, found.baselines["detour"].assessment) > CLEARANCE - 1e-6
    assert found.ratio_to_better_baseline < 1.0


def test_shortest_duration_around_a_post_is_the_exact_one(tmp_path):
    # Full acceleration up and down again, turned over at quarters, decides; x takes less.
    most = 10.0
    found = solve(
        gantry_problem(
            tmp_path,
            lowest=-0.05,
            acceleration=most,
            start="{ joints = [-0.3, 0.0] }",
            end="{ joints = [0.3, 0.0] }",
            minimise='objective = "duration"',
            duration="{ lower = 0.1, upper = 3.0 }",
            limits='jerk = "none"\ntorque = "none"',
        )
    )
    exact = 4.0 * np.sqrt(TOP / most)
    assert exact > 2.0 * np.sqrt(0.6 / most)
    assert exact < found.objective.value < 1.004 * exact


def test_a_motion_that_collides_with_nothing_is_solved_as_before(tmp_path):
    far = '[[cell.box]]\nname = "far"\nsize = [0.1, 0.1, 0.1]\nposition = [0.0, 3.0, 0.0]\n'
    pieces = {"start": "{ joints = [-0.4, -0.5] }", "end": "{ joints = [0.4, -0.5] }"}
    problem = gantry_problem(tmp_path, cell=far, **pieces)
    found = solve(problem)
    plain = solve(replace(problem, method=replace(problem.method, collisions="check")))
    assert found.objective.value == plain.objective.value
    assert found.solver.iterations == plain.solver.iterations


def test_check_mode_does_not_avoid_collisions(tmp_path):
    problem = gantry_problem(tmp_path, method='intervals = 20\ncollisions = "check"')
    found = solve(problem, throw=False)
    assert found.status == "certificate_failed"
    assert "base and hand" in found.message
    assert nearest(problem, found.assessment) == pytest.approx(
        -(ROUND - 0.05) + CLEARANCE, abs=1e-3
    )


@pytest.mark.parametrize(
    ("pieces", "words"),
    [
        ({"start": "{ joints = [0.0, 0.1] }"}, r"start: base is 90.0 mm deep in hand at this pose"),
        ({"end": "{ joints = [0.0, 0.195] }"}, r"motion.end: .* below cell.clearance of 10.0"),
        ({"motion": "via = [{ joints = [0.0, 0.1] }]"}, r"motion.via\[1\]: base is"),
        ({"cell": WALLS, "end": "{ joints = [0.2, 0.3] }"}, "correct the place of wall"),
    ],
)  # fmt: skip
def test_poses_that_collide_are_refused(tmp_path, capsys, pieces, words):
    path = write_gantry(tmp_path, **pieces)
    with pytest.raises(ProblemError, match=words):
        solve(load_problem(path).problem)
    assert command(["solve", str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_impassable_obstacle_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(path_search, "_MAX_TRIED_POSES", 3000)
    path = write_gantry(tmp_path, cell=WALLS, method="intervals = 20")
    assert command(["solve", str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 3
    said = " ".join(capsys.readouterr().out.split())
    assert "the clearance of hand and wall at 0.6" in said
    assert "No collision-free path was found" in said
    assert "motion.via" in said


def test_timed_out_path_search_is_reported(tmp_path):
    problem = gantry_problem(tmp_path, cell=WALLS, method="intervals = 20\ntime_limit = 3")
    told = solve(problem, throw=False)
    assert told.status == "certificate_failed"
    assert "The time limit ended the collision avoidance" in told.message
    assert "raise method.time_limit" in told.message
    assert "No way" not in told.message


def test_timed_out_solve_along_path_is_reported(tmp_path, monkeypatch):
    _, kept = solve_with_state(gantry_problem(tmp_path, method='collisions = "check"'))
    run, plain = kept
    ended = replace(plain, raw=replace(plain.raw, status="time_limit"))
    monkeypatch.setattr(collision_avoidance, "_solve_clear", lambda *_: ended)
    assert collision_avoidance.avoid_collisions(run, plain) is plain
    assert "raise method.time_limit" in run.avoidance_failure


def test_position_without_free_pose_is_named_without_search(tmp_path, monkeypatch):
    inside = "{ position = [0.0, 0.1, 0.1] }"
    problem = gantry_problem(tmp_path, end=inside, method="intervals = 20")
    tried = []
    monkeypatch.setattr(FreeSpace, "_connect_poses", lambda *given: tried.append(given))
    found = solve(problem, throw=False)
    assert not tried
    assert found.status == "certificate_failed"
    assert "No pose free of collisions was found for motion.end." in found.message
    monkeypatch.undo()
    space = FreeSpace(problem, 0, 60.0)
    points = np.array([[-HALF, 0.0], [0.0, 0.1], [HALF, 0.0]])
    assert space.blocked(points) == [1]
    assert space.path(points) is None
    assert space.tried == 6
    # As near as its clearance, to the digits of a file, a path leads there.
    points[1] = [0.0, TOP - 1e-6]
    assert space.path(points) is not None


def test_interruption_of_the_search_keeps_the_motion(tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(collision_avoidance.FreeSpace, "path", stop)
    found = solve(gantry_problem(tmp_path), throw=False)
    assert found.status == "interrupted"
    assert found.trajectory is not None
    # Stopped before it was clear: that is said.
    assert "But it does not keep the clearance of base and hand" in found.message
    assert "keeps all limits" not in found.message


def test_interruption_of_the_collision_check_keeps_the_motion(tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(programme, "with_collisions", stop)
    found = solve(gantry_problem(tmp_path), throw=False)
    assert found.status == "interrupted"
    assert found.solver.intervals == 40
    assert "But it does not keep the clearance of base and hand" in found.message


@pytest.mark.parametrize(
    ("pieces", "words"),
    [
        ({"method": "intervals = 40\nmax_iterations = 3"}, "But it does not keep the clearance"),
        (
            {"method": "intervals = 40\nmax_iterations = 1", "duration": "0.57"},
            "It exceeds .*And it does not keep the clearance",
        ),
    ],
)
def test_unfinished_solve_names_its_collisions(tmp_path, pieces, words):
    found = solve(gantry_problem(tmp_path, **pieces), throw=False)
    assert found.status == "iteration_limit"
    assert re.search(words, found.message)
    assert "keeps all limits" not in found.message
    assert found.message.endswith("do not run it.")


def test_position_is_reached_in_a_free_pose(tmp_path):
    # The tip can be at the end with the elbow up, which the box leaves room for, or down.
    urdf = PLANAR
    for name in ("upper", "fore"):
        urdf = urdf.replace(f'<link name="{name}">', f'<link name="{name}">{ROD}')
    write_robot(tmp_path, urdf_text=urdf)
    cell = '[[cell.box]]\nname = "low"\nsize = [0.1, 0.4, 0.1]\nposition = [0.3, 0.0, -0.3]\n'
    text = problem_text(
        start="{ joints = [0.0, -0.8] }",
        end="{ position = [0.6, 0.0, -0.1], near = [0.9, -1.4] }",
        duration="1.2",
        method="intervals = 16",
    )
    path = tmp_path / "problem.toml"
    path.write_text(text + cell)
    problem = load_problem(path).problem
    resolved = resolve(problem).end
    assert problem.clearance_model.distances(resolved).min() < 0.0
    found = solve(problem)
    assert nearest(problem, found.assessment) > -1e-5
    assert found.assessment.position[-1][1] > 0.0 > resolved[1]


def test_colliding_warm_start_is_avoided(tmp_path):
    below = "{ joints = [-0.4, -0.6] }", "{ joints = [0.4, -0.6] }"
    free = gantry_problem(tmp_path, start=below[0], end=below[1])
    family = ProblemFamily()
    _, warm = family.solve(free)
    assert warm is not None
    found, after = family.solve(gantry_problem(tmp_path), warm)
    assert found.status == "optimal"
    assert nearest(free, found.assessment) > CLEARANCE - 1e-5
    assert after is None


def test_a_pose_too_near_is_refused_after_a_warm_start_as_well(tmp_path):
    # By less than the certificate allows and more than the digits of a file.
    above = {"start": f"{{ joints = [-{HALF}, 0.6] }}"}
    family = ProblemFamily()
    _, warm = family.solve(gantry_problem(tmp_path, end="{ joints = [0.0, 0.3] }", **above))
    assert warm is not None
    near = gantry_problem(tmp_path, end=f"{{ joints = [0.0, {TOP - 3e-5}] }}", **above)
    with pytest.raises(ProblemError, match=r"motion.end: .* below cell.clearance"):
        family.solve(near, warm)


def test_progress_names_search_and_round(tmp_path):
    said = []
    solve(gantry_problem(tmp_path), progress=lambda event: said.append(event.stage))
    assert "searching a path around base and hand" in said
    assert any("clear of collisions, round 1" in stage for stage in said)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("objective", "place"),
    [
        ("torque_squared", 0.62),
        ("dynamic_deflection", 0.58),
        ("tool_deviation", 0.58),
        ("shaped_deviation", 0.58),
    ],
)
def test_every_objective_avoids_collisions(tmp_path, objective, place):
    urdf = PLANAR
    for name in ("upper", "fore"):
        urdf = urdf.replace(f'<link name="{name}">', f'<link name="{name}">{ROD}')
    write_robot(tmp_path, urdf_text=urdf)
    stop = (
        '[cell]\nclearance = "5 mm"\n[[cell.box]]\nname = "stop"\nsize = [0.15, 0.4, 0.1]\n'
        f"position = [{place}, 0.0, -0.1]\n"
    )
    path = tmp_path / "problem.toml"
    text = problem_text(
        duration="0.8", minimise=f'objective = "{objective}"', method="intervals = 24"
    )
    path.write_text(text + stop)
    problem = load_problem(path).problem
    unaware = solve(
        replace(problem, method=replace(problem.method, collisions="check")), throw=False
    )
    assert unaware.status == "certificate_failed"
    found = solve(problem)
    assert found.status.usable
    assert nearest(problem, found.assessment) > 5e-3 - 2e-5


SHELF = """[cell]
clearance = "10 mm"
floor = "0 m"
[[cell.box]]
name = "lower board"
size = [0.3, 0.8, 0.02]
position = [0.65, 0.0, 0.3]
[[cell.box]]
name = "upper board"
size = [0.3, 0.8, 0.02]
position = [0.65, 0.0, 0.65]
"""


@pytest.mark.slow
def test_seven_axes_go_from_the_top_of_a_shelf_to_the_board_below(tmp_path):
    # The hand would go straight through the upper board.
    write_gripper_urdf(tmp_path)
    urdf = tmp_path / "seven.urdf"
    text = urdf.read_text()
    for link, place, shape in (
        ("base", "0 0 0.1", '<cylinder radius="0.08" length="0.2"/>'),
        ("link_3", "0 0 -0.12", '<cylinder radius="0.05" length="0.2"/>'),
        ("link_5", "0 0 -0.15", '<cylinder radius="0.055" length="0.3"/>'),
        ("link_7", "0 0 0.05", '<cylinder radius="0.045" length="0.1"/>'),
        ("hand", "0 0 0.03", '<box size="0.05 0.2 0.06"/>'),
    ):
        text = text.replace(
            f'<link name="{link}">',
            f'<link name="{link}"><collision><origin xyz="{place}"/><geometry>{shape}</geometry>'
            "</collision>",
        )
    urdf.write_text(text)
    (tmp_path / "seven.toml").write_text(
        'schema = 1\nkind = "robot"\nname = "seven"\nurdf = "seven.urdf"\n'
        'tool = { link = "hand" }\nlock = { finger_1 = 0.02 }\n'
    )
    start, end = (
        f'{{ position = [0.62, {y}, {z}], rpy = ["180 deg", "-90 deg", "0 deg"], '
        "near = [0, 0.3, 0, -1.8, 0, 3.0, 0] }"
        for y, z in ((0.1, 0.85), (-0.1, 0.48))
    )
    path = tmp_path / "problem.toml"
    path.write_text(
        problem_text(
            "seven.toml",
            start=start,
            end=end,
            duration="2.0",
            limits='jerk = "none"\nacceleration = "none"',
            method="intervals = 24",
        )
        + SHELF
    )
    problem = load_problem(path).problem
    found = solve(problem)
    assert found.status.usable
    assert nearest(problem, found.assessment) > 0.01 - 5e-5


@pytest.mark.slow
def test_a_ur10_goes_from_the_top_of_a_shelf_into_it(tmp_path):
    path = tmp_path / "problem.toml"
    boards = "".join(
        f'[[cell.box]]\nname = "{name}"\nsize = [0.8, 0.44, 0.04]\nposition = [0.48, 1.13, {z}]\n'
        for name, z in (("lower", -0.02), ("upper", 0.4))
    )
    text = problem_text(
        "ur10",
        start="{ joints = [0.995, -0.728, 0.456, -1.705, -1.456, 0.0] }",
        end="{ joints = [1.0, -0.6, 1.0, -2.0, -1.5, 0.8] }",
        duration="2.0",
        limits='jerk = "none"\nacceleration = "none"',
        motion='boundary_acceleration = "free"',
        method="intervals = 40",
        extra="[payload]\nmass = 5\ninertia = [0.01, 0.01, 0.01]",
    )
    path.write_text(f"{text}[cell]\nclearance = 0.01\n{boards}")
    problem = load_problem(path).problem
    found = solve(problem)
    assert found.status.usable
    assert nearest(problem, found.assessment) > 0.01 - 5e-5
    unaware = solve(
        replace(problem, method=replace(problem.method, collisions="check")), throw=False
    )
    assert nearest(problem, unaware.assessment) < -0.005
    # Least torque costs hardly more around the edge of the board.
    assert found.objective.value < 1.05 * unaware.objective.value
