"""Freedom of a tool path: against dense scans by the exact laws, within its bounds, refusals."""

import json
from dataclasses import replace

import numpy as np
import pytest
from rail_arm import write_ur10_on_rail
from scipy.spatial.transform import Rotation

from stiffopt.certificate.assess import joint_windup
from stiffopt.certificate.rigid_body import rigid_body_history
from stiffopt.errors import InputError
from stiffopt.path.path_timing import fastest_timing
from stiffopt.problem import freedom_choice, freedom_programme
from stiffopt.problem.branches import solutions_of_pose
from stiffopt.problem.files import load_problem
from stiffopt.problem.freedom_goals import TimeGoal
from stiffopt.problem.freedom_programme import optimise_freedom
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.store import write_result
from stiffopt.robot.cell import Cell
from stiffopt.robot.frames import LinkFrame
from stiffopt.solver.solve import solve

# A spindle at a right angle to the flange: rotation about its axis moves the whole arm.
PROBLEM = """schema = 1
kind = "trajectory"
robot = "{robot}"

[tool]
link = "{link}"
offset = ["60 mm", 0.0, "60 mm"]
rpy = [0.0, "90 deg", 0.0]

[motion]
duration = {{ lower = "0.1 s" }}

[path]
start = {{ position = ["{x} mm", "-50 mm", "180 mm"], rpy = ["180 deg", 0, 0] }}
speed = "50 mm/s"

[path.freedom]
{freedom}

[path.force]
frame = "{frame}"
value = ["-15 N", "25 N", "8 N"]

[[path.segment]]
type = "lin"
to = {{ position = ["{x} mm", "50 mm", "180 mm"] }}

[[minimise]]
objective = "duration"
"""
ARMS = {"er3a_c60": ("link_6", 330), "ur10": ("flange", 600)}


@pytest.fixture
def choose(tmp_path, monkeypatch):
    """Load a problem with a freedom; return it, its task and the optima, best first."""

    def load(freedom, robot="er3a_c60", frame="path", more="", speed="50 mm/s"):
        link, x = ARMS[robot]
        file = tmp_path / "problem.toml"
        text = PROBLEM.format(robot=robot, link=link, x=x, freedom=freedom, frame=frame)
        end = text.index("[[minimise]]")
        file.write_text(text[:end].replace("50 mm/s", speed).rstrip() + f"\n{more}\n" + text[end:])
        kept = []

        def watched(task, near):
            kept[:] = [task, optimise_freedom(task, near)]
            return kept[1]

        monkeypatch.setattr(freedom_choice, "optimise_freedom", watched)
        return load_problem(file).problem, *kept

    return load


def deflection(problem, joints, force):
    """Deflection under a force (K, 3) by the certificate's kinematics and the exact laws."""
    still = np.zeros_like(joints)
    body = rigid_body_history(problem.robot, joints, still, still)
    pushed = np.einsum("kij,ki->kj", body.jacobian, force)
    turned = joint_windup(problem.robot, body.link_torque - pushed)
    turned -= joint_windup(problem.robot, body.link_torque)
    return np.linalg.norm(np.einsum("kij,kj->ki", body.jacobian, turned), axis=1)


def peak_on_path(problem):
    along = np.linspace(0.0, 1.0, 201)
    return deflection(problem, problem.path(along), problem.path_force(along)).max()


def holding_torque(problem):
    """Largest torques (n,) at rest on the path, by the certificate's dynamics, and dry friction."""
    along = np.linspace(0.0, 1.0, 201)
    joints = problem.path(along)
    body = rigid_body_history(problem.robot, joints, *[np.zeros_like(joints)] * 2)
    pushed = np.einsum("kij,ki->kj", body.jacobian, problem.path_force(along))
    return np.abs(body.gravity_torque - pushed).max(axis=0) + problem.robot.coulomb


def scan_of_rotations(problem, task, count):
    """Least peak over all postures and constant rotations, of poses solved one by one."""
    nodes = task.along[:: len(task.along) // 8]
    best = np.inf
    places, rotations = task.path.stated_poses(nodes)
    middle = len(nodes) // 2
    force = task.force(nodes / task.path.length)
    data = task.node_data(nodes)
    for spin in 2.0 * np.pi * np.arange(count) / count:
        turned = rotations[middle] @ Rotation.from_rotvec([0.0, 0.0, spin]).as_matrix()
        seeds = solutions_of_pose(
            problem.robot, places[middle], turned, np.zeros(6), lambda q: bool(np.all(abs(q) < 3.2))
        )
        for seed in seeds:
            joints = [seed] * len(nodes)
            for order in (range(middle, len(nodes)), range(middle, -1, -1)):
                q = seed[None]
                for k in order:
                    q, found = task.solve_poses(
                        q, np.zeros((6, 1)), np.array([[spin], [0.0], [0.0]]), data[:, [k]]
                    )
                    joints[k] = q[0] if found[0] else np.full(6, np.nan)
            if np.isfinite(joints).all():
                best = min(best, deflection(problem, np.array(joints), force).max())
    return best


@pytest.mark.slow
@pytest.mark.parametrize("robot", list(ARMS))
def test_rotation_and_posture_are_as_good_as_a_dense_scan(choose, robot):
    problem, task, _ = choose('tool_axis_rotation = "180 deg"', robot)
    assert peak_on_path(problem) <= 1.01 * scan_of_rotations(problem, task, 36)


def test_predicted_deflection_is_that_of_the_exact_laws_on_the_fitted_path(choose):
    problem, _, optima = choose('tool_axis_rotation = "30 deg"\nposture = "near"')
    assert peak_on_path(problem) == pytest.approx(optima[0].value, rel=0.01)


def test_less_deflection_than_without_freedom_and_within_its_bounds(choose):
    narrow, _, _ = choose('tool_axis_rotation = "0.01 deg"\nposture = "near"')
    free = 'tilt = "10 deg"\nplacement_box = ["20 mm", 0.0, "30 mm"]\nposture = "near"'
    problem, task, optima = choose(free)
    assert peak_on_path(problem) < 0.97 * peak_on_path(narrow)
    choice = optima[0].choice
    assert np.all(np.abs(choice.placement) <= task.freedom.placement + 1e-12)
    stated = task.path.stated_poses(task.along)[1][:, :, 2]
    axis = task.path.chosen(choice).poses(task.along)[1][:, :, 2]
    angle = np.arccos(np.clip(np.sum(stated * axis, axis=1), -1.0, 1.0))
    assert angle.max() <= task.freedom.tilt + 1e-9


@pytest.mark.parametrize("joint", [0, 1])
def test_drives_hold_the_chosen_path_at_rest(choose, monkeypatch, joint):
    """A torque limit below the torque at rest on the best path moves the path."""
    free = 'placement_box = ["20 mm", "10 mm", "30 mm"]\nposture = "near"'
    problem, _, optima = choose(free)
    needed = holding_torque(problem)[joint]
    limits = problem.robot.torque_max.tolist()
    limits[joint] = float(0.96 * needed)
    monkeypatch.setitem(globals(), "PROBLEM", f"{PROBLEM}\n[limits]\ntorque = {limits}\n")
    limited, _, others = choose(free)
    assert np.all(holding_torque(limited) <= limited.limits.torque)
    assert 1.01 * optima[0].value < others[0].value < 1.2 * optima[0].value


@pytest.mark.parametrize("frame", ["path", "base"])
def test_slopes_of_holding_torques_are_differences(choose, frame):
    _, task, optima = choose('placement_rotation = ["5 deg", 0, "5 deg"]', frame=frame)
    joints, data = optima[0].joints[:1], task.node_data(task.along)[:, :1]
    at = np.append(joints[0], optima[0].choice.placement)
    slopes = np.hstack([np.asarray(f) for f in task.hold_derivatives(joints[0], at[6:], data)])
    for k, step in enumerate(1e-6 * np.eye(12)):
        ends = [task.hold_excess(x[None, :6], x[6:, None], data)[0] for x in (at + step, at - step)]
        np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, slopes[:, k], atol=1e-6)


def test_tool_follows_the_placed_path(choose):
    problem, _, optima = choose('placement_box = ["20 mm", "10 mm", "30 mm"]\nposture = "near"')
    body = rigid_body_history(problem.robot, problem.path.points[[0, -1]], *[np.zeros((2, 6))] * 2)
    ends = np.array([[0.33, -0.05, 0.18], [0.33, 0.05, 0.18]])
    np.testing.assert_allclose(body.tool, ends + optima[0].choice.placement[:3], atol=1e-6)
    assert np.linalg.norm(optima[0].choice.placement) > 1e-3


def test_deflection_normal_to_the_face_alone_is_minimised(choose):
    free = 'tilt = "15 deg"\nposture = "near"\nerror_direction = "{}"'
    _, _, any_way = choose(free.format("any"))
    _, task, axial = choose(free.format("axis"))
    joints = any_way[0].joints
    angles = any_way[0].choice.angles(task.along).T
    still = np.zeros((6, len(joints)))
    other = task.errors(joints, still, angles, task.node_data(task.along)).max()
    assert axial[0].value < 0.98 * other


def test_time_goal_sees_blends_and_the_jerk_that_they_ask_for(choose):
    corner = """blend = "3 mm"

[[path.segment]]
type = "lin"
to = { position = ["350 mm", "50 mm", "180 mm"] }
blend = "3 mm"

[[path.segment]]
type = "lin"
to = { position = ["350 mm", "-50 mm", "180 mm"] }
"""
    freedom = 'tool_axis_rotation = "20 deg"\nposture = "near"\nminimise = "duration"'
    problem, task, _ = choose(freedom, more=corner, speed="1 m/s")
    goal = TimeGoal(task, 1.0)
    joints = problem.path(task.along / task.path.length)
    unmoved = np.zeros((6, len(joints)))
    time, _ = goal.evaluate(joints, unmoved, unmoved[:3], task.node_data(task.along))
    timed = fastest_timing(problem.robot, problem.active_limits, problem.path)
    # Steps of the jerk at ends and between the nodes are not seen.
    assert time == pytest.approx(timed.duration, rel=0.15)


def test_time_goal_is_that_of_one_joint_with_limited_acceleration(choose):
    _, task, _ = choose('tool_axis_rotation = "20 deg"\nposture = "near"\nminimise = "duration"')
    # Without a limit of the tool's speed.
    task.__dict__["least_steps"] = np.zeros(len(task.along) - 1)
    goal = TimeGoal(task, 1.0)
    # A straight line in joint space at rest at both ends: bang-bang.
    travel = 0.02
    joints = np.linspace(0.0, 1.0, len(task.along))[:, None] * np.full(6, travel)
    still = np.zeros((6, len(joints)))
    time, _ = goal.evaluate(joints, still, still[:3], task.node_data(task.along))
    slowest = (0.9 * task.limits.acceleration).min()
    least = 2.0 * np.sqrt(travel / slowest)
    assert time == pytest.approx(least, rel=0.05)


def test_slopes_of_the_programme_are_those_of_the_solved_poses(choose):
    _, task, optima = choose('tool_axis_rotation = "20 deg"\nposture = "near"')
    joints = optima[0].joints
    data = task.node_data(task.along)
    still = np.zeros((6, len(joints)))
    angles = optima[0].choice.angles(task.along).T
    step = 1e-5
    moved = angles + np.array([[step], [0.0], [0.0]])
    after, found = task.solve_poses(joints, still, moved, data)
    assert found.all()
    by_joints, by_parameters, slope, turned = (
        np.asarray(each)
        for each in task.derivatives.map(len(joints))(joints.T, still, angles, data)
    )
    count = len(joints)
    jacobian = by_joints.reshape(6, count, 6).transpose(1, 0, 2)
    wanted = by_parameters.reshape(6, count, 9).transpose(1, 0, 2)[:, :, 6]
    change = -np.linalg.solve(jacobian, wanted[:, :, None])[:, :, 0]
    np.testing.assert_allclose((after - joints) / step, change, atol=1e-3)
    square = task.errors(joints, still, angles, data) ** 2
    other = task.errors(after, still, moved, data) ** 2
    predicted = np.sum(slope.reshape(count, 6) * change, axis=1) + turned.reshape(count, 9)[:, 6]
    np.testing.assert_allclose((other - square) / step, predicted, rtol=1e-2, atol=1e-12)


@pytest.mark.parametrize(
    ("freedom", "frame", "words"),
    [
        ('posture = "near"', "path", "leaves nothing free"),
        ('tilt = "5 deg"', "tool", "would turn a force given in axes of the tool"),
        ('tilt = "-5 deg"', "path", "tilt"),
        ('tilt = "5 deg"\nplacement_box = ["1 m", 0.0, 0.0]\nspin = 3.0', "path", "spin"),
    ],
)
def test_freedom_that_cannot_be_used_is_refused(choose, freedom, frame, words):
    with pytest.raises(InputError, match=words):
        choose(freedom, frame=frame)


def test_error_under_no_force_is_refused(choose, tmp_path):
    link, x = ARMS["er3a_c60"]
    text = PROBLEM.format(robot="er3a_c60", link=link, x=x, freedom='tilt = "5 deg"', frame="path")
    begin, end = text.index("[path.force]"), text.index("[[path.segment]]")
    (tmp_path / "bare.toml").write_text(text[:begin] + text[end:])
    with pytest.raises(InputError, match="there is none"):
        load_problem(tmp_path / "bare.toml")


def test_path_out_of_reach_in_every_posture_is_named(choose, monkeypatch):
    monkeypatch.setitem(ARMS, "er3a_c60", ("link_6", 1500))
    with pytest.raises(InputError, match="does the arm follow the whole path"):
        choose('tool_axis_rotation = "180 deg"')


def test_path_that_leaves_reach_is_named(choose, monkeypatch):
    monkeypatch.setitem(globals(), "PROBLEM", PROBLEM.replace('", "50 mm"', '", "2 m"'))
    with pytest.raises(InputError, match="does the arm follow the whole path"):
        choose('tilt = "5 deg"\nposture = "near"')


def test_a_candidate_whose_splines_miss_its_poses_is_left_out(choose, monkeypatch):
    _, _, whole = choose('tool_axis_rotation = "180 deg"')
    evaluate, reached = freedom_programme._Search._evaluate, []

    def out_of_reach_at_first(search, y, guess):
        reached.append(search)
        return evaluate(search, y, guess) if len(reached) > 1 else None

    monkeypatch.setattr(freedom_programme._Search, "_evaluate", out_of_reach_at_first)
    _, _, others = choose('tool_axis_rotation = "180 deg"')
    assert len(others) == len(whole) - 1
    assert reached[1] is not reached[0]


@pytest.mark.slow
def test_a_posture_that_collides_comes_last(choose, tmp_path):
    problem, _, optima = choose('posture = "any"', "ur10")
    bodies = problem.robot.rigid_bodies()
    elbow, _ = bodies.pose(LinkFrame(3, np.zeros(3), np.eye(3)), optima[0].joints[0])
    place = ", ".join(f"{x:.4f}" for x in elbow)
    file = tmp_path / "problem.toml"
    box = f'[[cell.box]]\nname = "post"\nsize = [0.1, 0.1, 0.1]\nposition = [{place}]\n'
    file.write_text(file.read_text() + box)
    other = load_problem(file).problem
    assert np.abs(other.path.points[0] - problem.path.points[0]).max() > 0.3


@pytest.mark.slow
def test_a_rail_is_used(tmp_path):
    """The arm on a slide along the feed deflects less than the arm that stands."""
    write_ur10_on_rail(tmp_path)
    link, x = ARMS["ur10"]
    peaks = {}
    for name in ("ur10", "robot.toml"):
        file = tmp_path / "problem.toml"
        file.write_text(
            PROBLEM.format(robot=name, link=link, x=x, freedom='posture = "any"', frame="path")
        )
        peaks[name] = peak_on_path(load_problem(file).problem)
    assert peaks["robot.toml"] < 0.9 * peaks["ur10"]


def test_choice_of_a_solved_result_is_taken_without_a_search(choose, tmp_path, monkeypatch):
    problem, _, _ = choose('tool_axis_rotation = "20 deg"\nposture = "near"')
    kept = json.loads(json.dumps(problem.path_choice))

    def searched(task, near):
        raise AssertionError("searched")

    monkeypatch.setattr(freedom_choice, "optimise_freedom", searched)
    file = tmp_path / "problem.toml"
    again = load_problem(file, choice=kept).problem
    assert inputs_hash(again) == inputs_hash(problem)
    np.testing.assert_array_equal(again.path.coefficients, problem.path.coefficients)
    # Another task, or a document that is none, is not taken.
    file.write_text(file.read_text().replace("20 deg", "21 deg"))
    for other in (kept, {**kept, "joints": [[0.0]]}, "text"):
        with pytest.raises(AssertionError, match="searched"):
            load_problem(file, choice=other)
    file.write_text(file.read_text().replace("21 deg", "20 deg"))
    with pytest.raises(AssertionError, match="searched"):
        load_problem(file, choice={**kept, "joints": [[0.0]]})


@pytest.mark.parametrize(("name", "value"), [("origin", np.ones(3)), ("force_axes", "base")])
def test_choice_belongs_to_the_frame_that_is_placed(choose, name, value):
    _, task, _ = choose('placement_box = ["5 mm", 0, 0]\nposture = "near"')
    given = (np.zeros(task.robot.n), 1e-5, Cell())
    hashes = {
        freedom_choice._hash_of_inputs(each, *given)
        for each in (task, replace(task, **{name: value}))
    }
    assert len(hashes) == 2


def test_result_keeps_the_choice_of_its_path(choose, tmp_path):
    problem, _, _ = choose('tool_axis_rotation = "20 deg"\nposture = "near"')
    (tmp_path / "out").mkdir()
    write_result(solve(problem), tmp_path / "out", stated=problem)
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    assert document["path_choice"]["joints"] == problem.path_choice["joints"]


def test_the_fastest_of_optima_and_the_stated_path_is_taken(choose, tmp_path, monkeypatch):
    """By their timings: those of estimates have another order."""
    freedom = 'tool_axis_rotation = "20 deg"\nposture = "near"\nminimise = "duration"'
    choose(freedom)
    file = next(tmp_path.glob("*.toml"))
    timed = []

    def timing(problem):
        timed.append(problem.path_choice.get("as_stated", False))
        return 1.0 if timed[-1] else 2.0

    stated = load_problem(file, timing=timing).problem
    assert timed == [False] * (len(timed) - 1) + [True]
    assert "nothing is used" in stated.remarks[-1]
    assert set(stated.path_choice) == {"inputs_hash", "as_stated"}
    chosen = load_problem(file, timing=lambda problem: 2.0 - len(problem.path_choice)).problem
    assert "turns" in chosen.path_choice
    monkeypatch.setattr(freedom_choice, "optimise_freedom", None)
    again = load_problem(file, choice=stated.path_choice).problem
    np.testing.assert_array_equal(again.path.coefficients, stated.path.coefficients)
