"""Files of cycles: legs, payloads, branches, and sentences on what cannot be."""

import itertools
import re

import numpy as np
import pytest
from rail_arm import write_ur10_on_rail
from small_arms import ROOT
from small_cycles import GRIP, MOVES, write_cycle_file

from stiffopt.cli import run
from stiffopt.errors import InputFileError
from stiffopt.problem import branches
from stiffopt.problem.branches import CostTable, best_combination, branch_name, solutions_of_pose
from stiffopt.problem.cycle_files import load_cycle
from stiffopt.problem.files import load_problem
from stiffopt.robot.files import load_robot


def test_moves_become_legs_with_their_payloads(tmp_path):
    cycle = load_cycle(write_cycle_file(tmp_path)).cycle
    assert [leg.moves for leg in cycle.legs] == [(1, 2), (3,), (4,)]
    assert [leg.name for leg in cycle.legs] == ["above, pick", "place", "home"]
    masses = [leg.problem.robot.payload[0] for leg in cycle.legs]
    assert masses == pytest.approx([0.2, 1.2, 0.2])
    assert len(cycle.legs[0].problem.vias) == 1
    event = cycle.legs[1].stop.event
    assert (event.kind, event.mass_before, event.mass_after) == pytest.approx(("release", 1.2, 0.2))
    # A fixed time is shared by all legs, beside the dwells.
    lasting = sum(leg.problem.duration[0] for leg in cycle.legs)
    assert lasting == pytest.approx(3.0 - 0.1)


def test_stop_of_an_arm_whose_joints_a_position_fixes_needs_no_orientation(tmp_path):
    moves = """[[move]]
to = { position = [0.5, 0.1, 0.4], near = [0.2, -0.3, 0.6] }
[[move]]
to = { joints = [0.1, -0.2, 0.5] }
[[move]]
to = { position = [0.5, -0.1, 0.4] }
"""
    cycle = load_cycle(write_cycle_file(tmp_path, moves=moves)).cycle
    robot = cycle.first.robot
    ends = [leg.problem.end.joints for leg in cycle.legs]
    for q, side in ((ends[0], 0.1), (ends[2], -0.1)):
        assert robot.rigid_bodies().pose(robot.tool, q)[0] == pytest.approx([0.5, side, 0.4])
    assert ends[1] == pytest.approx([0.1, -0.2, 0.5])


def test_stop_of_an_arm_with_an_orientation_to_choose_needs_one(tmp_path):
    text = (ROOT / "problems" / "ur10_cycle.toml").read_text()
    path = tmp_path / "cycle.toml"
    path.write_text(re.sub(r"joints = \[.*\]", "position = [0.6, -0.3, 0.4]", text))
    with pytest.raises(InputFileError, match="add `rpy`"):
        load_cycle(path)


def test_speed_override_scales_the_velocity_limit_of_its_leg(tmp_path):
    moves = MOVES.replace('to = "home"', 'to = "home"\nspeed = 0.5')
    legs = load_cycle(write_cycle_file(tmp_path, moves=moves)).cycle.legs
    slow, usual = (legs[k].problem.active_limits.velocity for k in (2, 0))
    assert slow == pytest.approx(0.5 * usual)


def test_tool_change_and_process_force_by_move(tmp_path):
    moves = """[[move]]
to = "pick"
event = "tool_change"
payload = { mass = 0.7, inertia = [1e-3, 1e-3, 1e-3] }
tool = { link = "tip", offset = [0.1, 0.0, 0.0] }
[[move]]
to = "place"
process_force = [0.0, 0.0, 30.0]
[[move]]
to = "home"
"""
    cycle = load_cycle(write_cycle_file(tmp_path, moves=moves)).cycle
    masses = [leg.problem.robot.payload[0] for leg in cycle.legs]
    assert masses == pytest.approx([0.2, 0.7, 0.7])
    reach = [leg.problem.robot.tool.offset[0] for leg in cycle.legs]
    assert reach == pytest.approx([0.4, 0.5, 0.5])
    forces = [leg.problem.process_force[2] for leg in cycle.legs]
    assert forces == [0.0, 30.0, 0.0]
    event = cycle.legs[0].stop.event
    assert (event.kind, event.mass_before, event.mass_after) == ("tool_change", 0.2, 0.7)


@pytest.mark.parametrize(
    ("moves", "place", "words"),
    [
        ('[[move]]\nto = "place"\nevent = "release"\n', "move[1].event", "holds no part"),
        (MOVES.replace('to = "home"', 'to = "home"\nevent = "release"'), "move[4].event",
         "put down already"),
        (GRIP + GRIP.replace('"pick"', '"place"'), "move[2].event", "still holds the part"),
        ('[[move]]\nto = "pick"\nevent = "grip"\n', "move[1].payload", "needs the part"),
        ('[[move]]\nto = "pick"\nevent = "weld"\n', "move[1].event", "grip"),
        ('[[move]]\nto = "pik"\n', "move[1].to", "no pose 'pik'"),
        ('[[move]]\nto = "home"\n', "move[1].to", "where it begins"),
        ('[[move]]\nto = "pick"\nstop = false\n', "move[1].stop", "last move"),
        (MOVES.replace("dwell = 0.05", "dwell = 1.49"), "motion.duration", "leaves"),
        ('[[move]]\nto = "pick"\npayload = { mass = 1.0 }\n', "move[1].payload", "event is grip"),
    ],
)  # fmt: skip
def test_impossible_cycles_are_named_with_their_place(tmp_path, moves, place, words):
    path = write_cycle_file(tmp_path, moves=moves)
    with pytest.raises(InputFileError) as caught:
        load_cycle(path)
    assert f"{path}, {place}" in str(caught.value)
    assert words in str(caught.value)


def test_part_that_is_never_put_down_is_named_at_its_grip(tmp_path):
    text = (ROOT / "problems" / "ur10_cycle.toml").read_text().replace('event = "release"\n', "")
    (tmp_path / "cycle.toml").write_text(text)
    *before, last = load_cycle(tmp_path / "cycle.toml").cycle.legs
    (remark,) = [each for each in last.problem.remarks if "gripper" in each]
    assert remark.startswith("move[2].payload: the part is still in the gripper")
    assert not any("gripper" in each for leg in before for each in leg.problem.remarks)


def test_part_too_heavy_for_the_drives_is_named_at_its_grip():
    path = ROOT / "problems" / "ur10_cycle.toml"
    with pytest.raises(InputFileError, match=r"move\[2\]\.payload: the drives cannot hold"):
        load_cycle(path, ["move[2].payload.mass=5000 kg"])


def test_postures_that_cannot_be_held_take_no_place_among_the_nearest(monkeypatch):
    found = []

    def watched(*given):
        found.append(solutions_of_pose(*given))
        return found[-1]

    monkeypatch.setattr(branches, "solutions_of_pose", watched)
    path, limit = ROOT / "problems" / "ur10_cycle.toml", [180.0, 100.0, 90.0, 30.0, 30.0, 30.0]
    cycle = load_cycle(path, [f"limits.torque={limit}"]).cycle
    bodies = cycle.legs[1].problem.robot.rigid_bodies()
    torques = np.abs([bodies.gravity_torque(q) for each in found for q in each])
    assert len(torques) > 20
    assert np.all(torques <= limit)


def test_command_line_refuses_with_exit_code_2(tmp_path, capsys):
    path = write_cycle_file(tmp_path, moves='[[move]]\nto = "place"\nevent = "release"\n')
    assert run(["solve", str(path), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "move[1].event" in told
    assert "Traceback" not in told
    assert not (tmp_path / "out").exists()


def test_single_motions_know_named_poses_and_refuse_moves(tmp_path):
    path = write_cycle_file(tmp_path)
    with pytest.raises(InputFileError, match="cycle of several moves"):
        load_problem(path)
    path.write_text(
        path.read_text()
        .replace(MOVES, "")
        .replace('start = "home"', 'start = "home"\nend = "place"\nvia = ["above"]')
    )
    problem = load_problem(path).problem
    assert problem.end.joints == pytest.approx([-0.4, 0.1, 0.2])
    assert problem.vias[0].tolerance == 0.02


def test_limits_of_the_duty_are_read_with_their_units(tmp_path):
    duty = '[duty]\nrms_torque = [10, 20, 15]\nreducer_life = "20000 h"\nenergy = "0.2 kJ"\n'
    limits = load_cycle(write_cycle_file(tmp_path, extra=duty)).cycle.duty_limits
    assert limits.rms_torque == pytest.approx([10, 20, 15])
    assert (limits.reducer_life, limits.energy) == pytest.approx((7.2e7, 200.0))


def test_error_limit_needs_the_peak_of_a_deflection(tmp_path):
    free = "{ upper = 5.0 }\nerror_limit = '1 mm'"
    cycle = load_cycle(write_cycle_file(tmp_path, duration=free)).cycle
    assert cycle.error_limit == pytest.approx(1e-3)
    assert cycle.time_is_minimised
    for changed in ({"duration": free, "objective": "torque_squared"},
                    {"duration": "3.0\nerror_limit = '1 mm'"}):  # fmt: skip
        with pytest.raises(InputFileError, match=r"motion\.error_limit: bounds the peak"):
            load_cycle(write_cycle_file(tmp_path, **changed))


def test_free_time_needs_the_objective_duration(tmp_path):
    path = write_cycle_file(tmp_path, duration="{ upper = 5.0 }")
    with pytest.raises(InputFileError, match="objective duration"):
        load_cycle(path)


def test_best_combination_is_that_of_all_combinations():
    random = np.random.default_rng(3)
    sizes = (3, 4, 2, 5, 3)
    # Poses recur, as those above a pick do.
    route = [0, 1, 2, 1, 3, 4, 3, 1, 0]
    tables = [
        CostTable((a, b), random.uniform(size=(sizes[a], sizes[b])))
        for a, b in itertools.pairwise(route)
    ]

    def total(choice):
        return sum(table.cost[tuple(choice[p] for p in table.poses)] for table in tables)

    every = list(itertools.product(*(range(size) for size in sizes)))
    assert total(best_combination(tables, 5)) == pytest.approx(min(map(total, every)), abs=1e-12)


def test_branches_of_a_pose_have_eight_names_and_one_tool_pose():
    robot = load_robot("er3a_c60")
    bodies = robot.rigid_bodies()
    q = np.array([0.3, 0.2, -0.1, 0.4, 0.9, -0.5])
    position, rotation = bodies.pose(robot.tool, q)
    found = solutions_of_pose(robot, position, rotation, q, lambda _: True)
    for each in found:
        place, turn = bodies.pose(robot.tool, each)
        assert place == pytest.approx(position, abs=1e-8)
        assert turn == pytest.approx(rotation, abs=1e-7)
        assert np.all((each >= robot.position_lower) & (each <= robot.position_upper))
    names = {branch_name(robot, each) for each in found}
    assert len(names) >= 4
    assert found[0] == pytest.approx(q, abs=1e-7)
    home = np.zeros(6)
    assert branch_name(robot, home).startswith("shoulder front, elbow up")
    # A flip of the wrist changes the name of the wrist alone.
    flipped = q + np.array([0, 0, 0, -np.pi, -2 * q[4], np.pi])
    first, second = (branch_name(robot, each).split(", ") for each in (q, flipped))
    assert first[:2] == second[:2]
    assert first[2] != second[2]


def test_continuous_joints_go_the_short_way_round():
    """A pose beyond half a turn is taken at 200 degrees from 172, not at -160."""
    robot = load_robot("ur10")
    bodies = robot.rigid_bodies()
    here = np.array([3.0, -1.4, 1.9, -2.0, -1.57, 0.0])
    there = here + np.array([0.5, 0, 0, 0, 0, 0])
    position, rotation = bodies.pose(robot.tool, there)
    found = solutions_of_pose(robot, position, rotation, here, lambda _: True)
    assert found[0] == pytest.approx(there, abs=1e-7)


def test_a_rail_is_moved_where_that_is_quicker(tmp_path):
    """Poses of a cycle are taken with the rail where its arm has less to turn."""
    write_ur10_on_rail(tmp_path)
    text = (ROOT / "problems" / "ur10_cycle.toml").read_text()
    text = text.replace('robot = "ur10"', 'robot = "robot.toml"')
    home = 'position = ["600 mm", "-300 mm", "400 mm"]\nrpy = ["180 deg", 0, 0]'
    path = tmp_path / "cycle.toml"
    path.write_text(re.sub(r"joints = \[.*\]", home, text))
    cycle = load_cycle(path).cycle
    bodies, tool = cycle.first.robot.rigid_bodies(), cycle.first.robot.tool
    places = {each.name: each.joints for each in cycle.postures}
    assert np.ptp([q[0] for q in places.values()]) > 0.05
    assert all(-0.5 <= q[0] <= 0.5 for q in places.values())
    assert bodies.pose(tool, places["home"])[0] == pytest.approx([0.6, -0.3, 0.4], abs=1e-6)


def test_robot_is_loaded_once_for_equal_parts_gripped_in_two_moves(tmp_path):
    loaded = []

    def counted(name):
        loaded.append(name)
        return load_robot(name)

    path = write_cycle_file(tmp_path, moves=MOVES + MOVES)
    legs = load_cycle(path, robots=counted).cycle.legs
    assert legs[1].problem.robot is legs[4].problem.robot
    assert len(loaded) == 2


def test_moves_may_end_with_the_part_in_the_gripper(tmp_path):
    moves = MOVES.replace('event = "release"', "")
    cycle = load_cycle(write_cycle_file(tmp_path, moves=moves)).cycle
    first, *others = (leg.problem.robot.payload[0] for leg in cycle.legs)
    assert others[0] > first
    assert others[-1] == others[0]
