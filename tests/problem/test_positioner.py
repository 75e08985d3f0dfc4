"""Tool paths on work that a positioner carries: followed, timed, chosen, and refused."""

import numpy as np
import pytest
from turntable_arm import write_ur10_with_turntable

from stiffopt.certificate.assess import joint_windup
from stiffopt.certificate.rigid_body import rigid_body_history, tool_positions
from stiffopt.errors import InputError
from stiffopt.path.path_timing import PathDemands, fastest_timing
from stiffopt.problem import freedom_choice, freedom_scan
from stiffopt.problem.files import load_problem
from stiffopt.problem.freedom_programme import optimise_freedom

# Half a circle about the axis of the table, 200 mm above it.
PROBLEM = """schema = 1
kind = "trajectory"
robot = "robot.toml"

[tool]
link = "{tool}"
offset = [0.0, 0.0, "150 mm"]
process_force = [{push}, 0.0, 0.0]

[motion]
duration = {{ lower = "0.1 s" }}

[path]
frame = {{ link = "{link}", position = [0.0, 0.0, "200 mm"] }}
start = {{ position = ["150 mm", 0.0, 0.0], rpy = ["180 deg", 0, 0] }}
speed = "50 mm/s"
{freedom}

[path.force]
frame = "path"
value = ["-15 N", "25 N", "8 N"]

[[path.segment]]
type = "circ"
through = [0.0, "150 mm", 0.0]
to = {{ position = ["-150 mm", 0.0, 0.0] }}

[[minimise]]
objective = "duration"
"""


OTHER_HALF = """[[path.segment]]
type = "circ"
through = [0.0, "-150 mm", 0.0]
to = { position = ["150 mm", 0.0, 0.0] }

"""


@pytest.fixture
def load(tmp_path):
    def load(freedom="", *, link="table", named=True, push=0.0, tool="flange", whole=False):
        write_ur10_with_turntable(tmp_path, named)
        file = tmp_path / "problem.toml"
        text = PROBLEM.format(freedom=freedom, link=link, push=push, tool=tool)
        end = text.index("[[minimise]]")
        file.write_text(text[:end] + (OTHER_HALF if whole else "") + text[end:])
        return load_problem(file).problem

    return load


def test_tool_follows_the_path_on_the_table(load):
    problem = load()
    q = problem.path(np.linspace(0.0, 1.0, 101))
    places = tool_positions(problem.robot, q)
    np.testing.assert_allclose(np.hypot(*places[:, :2].T), 0.15, atol=5e-5)
    np.testing.assert_allclose(places[:, 2], 0.2, atol=5e-5)
    table = problem.robot.joint_names.index("turn")
    assert np.ptp(q[:, table]) > 0.1
    assert any("7 joints, and a pose fixes 6" in note for note in problem.remarks)


def test_tool_speed_is_relative_to_the_work(load):
    problem = load()
    law = fastest_timing(problem.robot, problem.active_limits, problem.path, PathDemands())
    motion = problem.path.follow(law)
    time = np.linspace(0.0, motion.duration, 2001)
    speed = np.linalg.norm(
        np.gradient(tool_positions(problem.robot, motion(time)), time, axis=0), axis=1
    )
    assert np.median(speed) == pytest.approx(0.05, rel=1e-3)
    assert speed.max() <= 0.05 * 1.002


def test_force_loads_the_table_by_its_reaction(load):
    problem = load()
    s = np.linspace(0.0, 1.0, 11)
    q, force = problem.path(s), problem.path_force(s)
    body = rigid_body_history(problem.robot, q, np.zeros_like(q), np.zeros_like(q))
    table = problem.robot.joint_names.index("turn")
    pushed = np.einsum("kij,ki->kj", body.jacobian, force)[:, table]
    moment = np.cross(body.tool, force)[:, 2]
    np.testing.assert_allclose(pushed, -moment, atol=1e-9)
    assert np.abs(moment).min() > 1.0


@pytest.mark.slow
def test_a_table_turns_once_under_a_circle_where_that_deflects_least(load, monkeypatch):
    turned = load("[path.freedom]", whole=True)
    table = turned.robot.joint_names.index("turn")
    assert abs(turned.path(1.0)[table] - turned.path(0.0)[table]) == pytest.approx(
        2.0 * np.pi, abs=0.5
    )
    monkeypatch.setattr(freedom_scan, "_turning_angles", lambda task, nodes: [])
    swung = load("[path.freedom]", whole=True)
    values = [each.path_choice["value"] for each in (turned, swung)]
    assert values[0] < 0.9 * values[1]


@pytest.mark.slow
def test_choice_is_as_good_as_a_scan_of_the_tables_angle(load, monkeypatch):
    kept = []

    def watched(task, near):
        kept[:] = [task, optimise_freedom(task, near)]
        return kept[1]

    monkeypatch.setattr(freedom_choice, "optimise_freedom", watched)
    problem = load('[path.freedom]\ntool_axis_rotation = "180 deg"\nvariation = "constant"')
    task, optima = kept
    n, table = problem.robot.n, problem.robot.joint_names.index("turn")
    nodes = task.along[:: len(task.along) // 8]
    data, force = task.node_data(nodes), task.force(nodes / task.path.length)
    held = np.arange(n) == table
    best = np.inf
    rng = np.random.default_rng(2)
    lower, upper = task.position_range
    for angle in np.linspace(lower[table], upper[table], 25):
        for spin in 2.0 * np.pi * np.arange(8) / 8:
            seeds = rng.uniform(np.maximum(lower, -3.2), np.minimum(upper, 3.2), (30, n))
            seeds[:, table] = angle
            turns = np.zeros((3, 30))
            turns[0] = spin
            q, found = task.solve_poses(seeds, np.zeros((6, 30)), turns, data[:, [0] * 30], held)
            joints = [q]
            for k in range(1, len(nodes)):
                before = joints[-1]
                q, reached = task.solve_poses(
                    before, np.zeros((6, 30)), turns, data[:, [k] * 30], held
                )
                found &= reached & (np.abs(q - before).max(axis=1) < 1.5)
                joints.append(q)
            for column in np.stack(joints, axis=1)[found]:
                still = np.zeros_like(column)
                body = rigid_body_history(problem.robot, column, still, still)
                pushed = np.einsum("kij,ki->kj", body.jacobian, force)
                turned = joint_windup(problem.robot, body.link_torque - pushed)
                turned -= joint_windup(problem.robot, body.link_torque)
                moved = np.einsum("kij,kj->ki", body.jacobian, turned)
                best = min(best, np.linalg.norm(moved, axis=1).max())
    assert np.isfinite(best)
    assert optima[0].value <= 1.01 * best


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"named": False}, r"path\.frame\.link: .*'table' does not move.*turn.*\[\[joint\]\]"),
        ({"link": "tabel"}, r"path\.frame\.link: no link 'tabel'.*table"),
        ({"link": "flange"}, r"path\.frame\.link: .*'flange' moves with the tool"),
        ({"push": 5.0}, r"tool\.process_force.*path\.force"),
    ],
)
def test_work_that_cannot_be_carried_is_refused(load, given, words):
    with pytest.raises(InputError, match=words):
        load(**given)
