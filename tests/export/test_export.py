"""Exported motions, read back by their readers."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from importlib import resources
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.interpolate import BPoly
from synthetic_solution import assessment, solution, trajectory_columns

from stiffopt.cli import run
from stiffopt.export.format import FORMATS, maker_of, read_seal
from stiffopt.export.motion import MotionEvent, read_motion
from stiffopt.files import write_csv
from stiffopt.problem.files import load_problem
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.store import export_times, write_result

DURATION = 0.4507


def swing(time):
    """Positions (K, 6) of a rest-to-rest motion and their first two derivatives."""
    s, rate = time[:, None] / DURATION, 1.0 / DURATION
    far = FAR
    position = far * (10 * s**3 - 15 * s**4 + 6 * s**5)
    velocity = far * rate * (30 * s**2 - 60 * s**3 + 30 * s**4)
    return position, velocity, far * rate**2 * (60 * s - 180 * s**2 + 120 * s**3)


FAR = np.array([0.5, -1.0, 1.2, -2.0, 0.3, 6.0])
PROBLEM = """schema = 1
kind = "trajectory"
title = "Pick – and place"
robot = "{robot}"

[payload]
mass = "{mass} kg"
inertia = [0.01, 0.01, 0.01]

[motion]
start = {{ joints = {start} }}
end = {{ joints = {end} }}
duration = "0.4507 s"

[[minimise]]
objective = "torque_squared"

[limits]
position_lower = [-7, -7, -7, -7, -7, -7]
position_upper = [7, 7, 7, 7, 7, 7]
velocity = [30, 30, 30, 30, 30, {velocity}]
acceleration = "none"
jerk = "none"
torque = "none"
"""


def write_stated(folder, far=FAR, **changes):
    """Problem file of `swing`, without limits but those of position and velocity."""
    values = {"robot": "ur10", "mass": 5, "velocity": 30, "start": [0.0] * 6, "end": far.tolist()}
    path = folder / "problem.toml"
    path.write_text(PROBLEM.format(**values | changes), encoding="utf-8")
    return path


def seal(folder, **changes):
    """result.json of whatever motion the folder holds."""
    file = folder / "problem.toml"
    problem = load_problem(file).problem
    own = {"assessment": assessment(6, DURATION), "inputs_hash": inputs_hash(problem)} | changes
    write_result(solution(6, **own), folder, file, stated=problem)


def write_motion(folder, far=FAR, time=None, change=None):
    """trajectory.csv of `swing`, links 1 % behind; `change` edits the columns in place."""
    time = export_times(DURATION) if time is None else time
    position, velocity, acceleration = (each * far / FAR for each in swing(time))
    names = trajectory_columns(6) + [f"link{j}" for j in range(1, 7)]
    columns = np.zeros((len(time), len(names)))
    columns[:, 0], columns[:, 1:7], columns[:, 7:13] = time, position, velocity
    columns[:, 13:19], columns[:, -6:] = acceleration, 0.99 * position
    if change is not None:
        columns = change(columns)
    write_csv(folder / "trajectory.csv", names, columns.tolist())


# Arm of each maker whose programs are written, by its format.
MODELS = {
    "krl-rsi": "kr6_demo",
    "abb-egm": "irb_demo",
    "fanuc-stream": "lrmate_demo",
    "yaskawa-job": "gp7_demo",
    "staubli-val3": "tx2_60_demo",
}


def write_result_of_arm(folder, to):
    """Result folder of `folder` for an arm of a format's maker, with the bodies of the UR10."""
    own = resources.files("stiffopt.robot").joinpath("data", "ur10")
    text = own.joinpath("robot.toml").read_text(encoding="utf-8")
    name = MODELS.get(to, "ur10")
    (folder / "robot.urdf").write_text(own.joinpath("robot.urdf").read_text(encoding="utf-8"))
    (folder / "arm.toml").write_text(text.replace('name = "ur10"', f'name = "{name}"', 1))
    write_stated(folder, robot="arm.toml")
    write_motion(folder)
    seal(folder)
    return name


@pytest.fixture
def folder(tmp_path):
    """Result folder of a motion of six turning joints, links 1 % behind the motors."""
    write_stated(tmp_path)
    write_motion(tmp_path)
    seal(tmp_path)
    return tmp_path


def test_resampled_motion_is_unchanged(folder):
    motion = read_motion(folder).sampled(777.0)
    position, velocity, acceleration = swing(motion.time)
    assert motion.time[-1] == DURATION
    np.testing.assert_allclose(motion.position, position, atol=1e-9)
    np.testing.assert_allclose(motion.velocity, velocity, atol=1e-6)
    np.testing.assert_allclose(
        motion.acceleration, acceleration, atol=0.03
    )  # h^2/8 |q4|, straight between rows
    links = read_motion(folder, "link").sampled(777.0)
    np.testing.assert_allclose(links.position, 0.99 * position, atol=1e-6)


def test_export_uses_the_command_if_present(folder):
    names = [f"{quantity}{j}" for quantity in ("q", "qd", "qdd") for j in range(1, 7)]
    time = export_times(DURATION + 0.02)
    moved = swing(np.minimum(time, DURATION))
    columns = np.hstack([time[:, None], *(1.01 * each for each in moved)])
    write_csv(folder / "command.csv", ["t", *names], columns.tolist())
    seal(folder)
    motor, link = (read_motion(folder, of).sampled(500.0) for of in ("motor", "link"))
    assert motor.time[-1] == pytest.approx(DURATION + 0.02)
    np.testing.assert_allclose(motor.position[100], 1.01 * swing(motor.time)[0][100], atol=1e-9)
    np.testing.assert_allclose(link.position[100], 0.99 * swing(link.time)[0][100], atol=1e-6)


def test_whole_steps_hold_the_end_position(folder):
    motion = read_motion(folder).sampled(250.0, whole_steps=True)
    np.testing.assert_allclose(np.diff(motion.time), 4e-3, rtol=1e-9)
    assert DURATION <= motion.time[-1] < DURATION + 4e-3
    np.testing.assert_allclose(motion.position[-1], swing(np.array([DURATION]))[0][0], atol=1e-12)
    assert not motion.velocity[-1].any()
    assert not motion.acceleration[-1].any()


def test_ros2_is_a_message_of_rosbags_types(folder):
    stores = pytest.importorskip("rosbags.typesys")
    yaml = pytest.importorskip("ruamel.yaml").YAML(typ="safe")
    assert run(["export", str(folder), "--to", "ros2", "--rate", "125"]) == 0
    document = yaml.load((folder / "joint_trajectory.yaml").read_text(encoding="utf-8"))
    store = stores.get_typestore(stores.Stores.LATEST)
    kind = {name.rsplit("/", 1)[1]: known for name, known in store.types.items()}
    # Each message takes exactly the fields of the document: one missing or unknown is an error.
    points = [
        kind["JointTrajectoryPoint"](
            **{name: np.array(values, dtype=float) for name, values in point.items()
               if name != "time_from_start"},
            time_from_start=kind["Duration"](**point["time_from_start"]),
        )
        for point in document["points"]
    ]  # fmt: skip
    header = document["header"]
    message = kind["JointTrajectory"](
        header=kind["Header"](stamp=kind["Time"](**header["stamp"]), frame_id=header["frame_id"]),
        joint_names=document["joint_names"],
        points=points,
    )
    name = "trajectory_msgs/msg/JointTrajectory"
    back = store.deserialize_cdr(store.serialize_cdr(message, name), name)
    assert back.joint_names == [f"j{j}" for j in range(1, 7)]
    time = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in back.points])
    assert time[0] == 0.0
    assert time[-1] == pytest.approx(DURATION, abs=1e-9)
    expected = swing(np.minimum(time, DURATION))
    for quantity, values in zip(
        ("positions", "velocities", "accelerations"), expected, strict=True
    ):
        found = np.array([getattr(point, quantity) for point in back.points])
        np.testing.assert_allclose(found, values, atol=1e-4)
    assert not any(len(point.effort) for point in back.points)


def test_tiny_numbers_stay_numbers_in_yaml():
    from stiffopt.export.formats.sampled_points import _format_numbers

    yaml = pytest.importorskip("ruamel.yaml").YAML(typ="safe")
    values = [1e-05, -3e-17, 1.5e-08, 0.0, 12.0]
    assert yaml.load(_format_numbers(values)) == values


def test_urscript_parsed_back_is_the_motion(folder):
    assert run(["export", str(folder), "--to", "urscript"]) == 0
    text = (folder / "motion.script").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    (name,) = re.fullmatch(r"def (\w+)\(\):", lines[0]).groups()
    assert name.isascii()
    assert lines[-3:] == ["  stopj(2.0)", "end", f"{name}()"]
    first = re.fullmatch(r"  movej\(\[(.+)\], a=0.5, v=0.25\)", lines[1])
    follow = [
        re.fullmatch(r"  servoj\(\[(.+)\], t=(\S+), lookahead_time=(\S+), gain=(\d+)\)", line)
        for line in lines[2:-3]
    ]
    assert {match[2] for match in follow} == {"0.002"}
    assert all(0.03 <= float(m[3]) <= 0.2 and 100 <= int(m[4]) <= 2000 for m in follow)
    poses = np.array([[float(q) for q in m[1].split(",")] for m in [first, *follow]])
    time = np.minimum(np.arange(len(poses)) * 0.002, DURATION)
    np.testing.assert_allclose(poses, swing(time)[0], atol=1e-8)
    assert time[-1] == DURATION


def test_krl_corrections_are_relative_to_the_start(folder):
    write_result_of_arm(folder, "krl-rsi")
    assert run(["export", str(folder), "--to", "krl-rsi", "--of", "link"]) == 0
    (source,) = folder.glob("*.src")
    program = source.read_text(encoding="ascii").splitlines()
    (start,) = [line for line in program if line.startswith("PTP {")]
    begin = np.array([float(v) for v in re.findall(r"A\d (-?[\d.]+)", start)])
    order = [line for line in program if line.startswith(("PTP {", "ret =", "RSI_MOVECORR"))]
    words = ["PTP", "RSI_CREATE", "RSI_ON(#ABSOLUTE)", "RSI_MOVECORR()", "RSI_OFF()"]
    assert all(word in line for word, line in zip(words, order, strict=True))
    text = (folder / f"{source.stem}_rsi.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(io.StringIO(read_seal(text)[1])))
    corrections = np.array([[float(row[f"A{j}"]) for j in range(1, 7)] for row in rows])
    assert not corrections[0].any()
    time = np.minimum(np.arange(len(rows)) / 250.0, DURATION)
    wanted = np.degrees(0.99 * swing(time)[0])
    np.testing.assert_allclose(begin + corrections, wanted, atol=1e-4)
    assert all(len(line) < 256 for line in program)


@pytest.mark.parametrize(
    ("to", "program", "words"),
    [
        ("abb-egm", "*.mod", ["MoveAbsJ start_pose", "EGMActJoint", "EGMRunJoint", "EGMReset"]),
        ("fanuc-stream", "*.ls", ["J P[1] 10% FINE", "IBGN start[1]", "IBGN end[1]"]),
    ],
)
def test_programs_approach_the_start_and_take_absolute_positions(folder, to, program, words):
    write_result_of_arm(folder, to)
    assert run(["export", str(folder), "--to", to]) == 0
    (source,) = folder.glob(program)
    text = source.read_text(encoding="ascii")
    places = [text.index(word) for word in words]
    assert places == sorted(places)
    (table,) = folder.glob("stiffopt*.csv")
    rows = list(csv.reader(io.StringIO(read_seal(table.read_text(encoding="utf-8"))[1])))
    assert rows[0] == [f"J{j}" for j in range(1, 7)]
    angles = np.array(rows[1:], dtype=float)
    time = np.minimum(np.arange(len(angles)) / FORMATS[to].rate, DURATION)
    np.testing.assert_allclose(angles, np.degrees(swing(time)[0]), atol=1e-5)


PULSES = [1341.4, -1907.7, 1593.0, 1023.0, 980.0, 455.0]
VELOCITY_MAX = np.array([10.0, 10.0, 10.0, 15.0, 20.0, 30.0])


def there_and_back(folder):
    """Motion of `folder`, a rest of 0.3 s in which the gripper closes, and the way back."""
    stored = read_motion(folder)
    time = np.append(export_times(DURATION), DURATION + 0.3 + export_times(DURATION))
    there, back = swing(export_times(DURATION)), swing(DURATION - export_times(DURATION))
    rows = [np.vstack([a, s * b]) for a, b, s in zip(there, back, (1, -1, 1), strict=True)]
    curve = BPoly.from_derivatives(time, np.stack(rows, axis=1))
    events = (MotionEvent(time=DURATION, kind="grip", mass=2.5),)
    robot = replace(stored.problem.robot, velocity_max=VELOCITY_MAX)
    problem = replace(stored.problem, robot=robot)
    return replace(stored, curve=curve, link=None, events=events, problem=problem)


def test_yaskawa_job_has_moves_rest_and_gripper(folder):
    write_result_of_arm(folder, "yaskawa-job")
    (name, text), *_ = FORMATS["yaskawa-job"].with_pulses(PULSES).export(
        there_and_back(folder), 40.0
    ).items()  # fmt: skip
    lines = text.split("\r\n")
    assert name == f"{lines[1].removeprefix('//NAME ')}.JBI"
    points = {key: np.array(row.split(","), dtype=int) for key, row in
              (line.split("=") for line in lines if re.match(r"C\d{5}=", line))}  # fmt: skip
    assert f"///NPOS {len(points)},0,0,0,0,0" in lines
    # Exports of one motion are equal on every day.
    assert "///DATE 2000/01/01 00:00" in lines
    code = lines[lines.index("NOP") + 1 : lines.index("END")]
    assert all(len(line) <= 33 for line in code)
    moves = [line.split() for line in code if line.startswith("MOVJ")]
    assert [move[1] for move in moves] == list(points)
    # At the speeds of the job, the fastest joint passes the points in the planned time.
    angles = np.radians(np.array(list(points.values())) / PULSES)
    speeds = np.array([float(move[2].removeprefix("VJ=")) for move in moves[1:]]) / 100.0
    seconds = np.max(np.abs(np.diff(angles, axis=0)) / VELOCITY_MAX, axis=1) / speeds
    assert np.sum(seconds) == pytest.approx(2 * DURATION, abs=5e-3)
    grip = code.index("DOUT OT#(1) ON")
    assert code[grip - 1] == "'grip, then 2.5 kg"
    assert code[grip - 2].endswith("PL=0")
    assert float(code[grip + 1].removeprefix("TIMER T=")) == pytest.approx(0.3, abs=0.01)
    at_grip = points[code[grip - 2].split()[1]]
    np.testing.assert_allclose(at_grip / PULSES, np.degrees(FAR), atol=2e-3)


def test_val3_application_has_moves_rest_and_gripper(folder):
    write_result_of_arm(folder, "staubli-val3")
    texts = FORMATS["staubli-val3"].export(there_and_back(folder), 40.0)
    trees = {name.split("/")[1]: ElementTree.fromstring(text) for name, text in texts.items()}
    named = [each.get("file") for each in trees["pick___and_plac.pjx"].iter() if each.get("file")]
    assert sorted([*named, "pick___and_plac.pjx"]) == sorted(trees)
    arrays = {each.get("name"): list(each) for each in trees["pick___and_plac.dtx"].iter()
              if each.get("name")}  # fmt: skip
    angles = np.array([[float(row.get(f"j{j}")) for j in range(1, 7)] for row in arrays["jMotion"]])
    (code,) = (each.text.split("\n") for each in trees["start.pgx"].iter() if "Code" in each.tag)
    code = [line.strip() for line in code]
    moves = [line for line in code if line.startswith("movej")]
    assert moves == [f"movej(jMotion[{k}],tTool,mMotion[{k}])" for k in range(len(angles))]
    assert len(arrays["mMotion"]) == len(angles)
    middle = code.index("close(tTool)")
    assert code[middle - 1] == code[middle + 1] == "waitEndMove()"
    assert float(code[middle + 2][6:-1]) == pytest.approx(0.3, abs=5e-3)
    at_grip = [line for line in code[:middle] if line.startswith("movej")]
    np.testing.assert_allclose(angles[len(at_grip) - 1], np.degrees(FAR), atol=1e-5)
    assert arrays["mMotion"][len(at_grip) - 1].get("blend") == "off"
    assert {each.get("blend") for each in arrays["mMotion"][1 : len(at_grip) - 1]} == {"joint"}


def test_val3_data_are_checked(folder, capsys):
    write_result_of_arm(folder, "staubli-val3")
    out = folder / "out"
    assert run(["export", str(folder), "--to", "staubli-val3", "--out", str(out)]) == 0
    data = out / "pick___and_plac" / "pick___and_plac.dtx"
    assert run(["check", str(data), "--result", str(folder)]) == 0
    data.write_text(data.read_text().replace('j2="-5', 'j2="-6', 1))
    assert run(["check", str(data), "--result", str(folder)]) == 2
    assert "was changed after its export" in capsys.readouterr().err


@pytest.mark.parametrize("to", list(MODELS))
def test_programs_go_to_arms_of_their_maker_only(folder, to, capsys):
    assert run(["export", str(folder), "--to", to]) == 2
    told = capsys.readouterr().err
    assert "ur10 is one of Universal Robots" in told
    assert "csv or ros2 or urscript" in told


def test_csv_has_the_joints_names(folder, tmp_path):
    assert run(["export", str(folder), "--to", "csv", "--rate", "1000", "--out",
                str(tmp_path / "out")]) == 0  # fmt: skip
    text = read_seal((tmp_path / "out" / "motor.csv").read_text(encoding="utf-8"))[1]
    rows = list(csv.DictReader(io.StringIO(text)))
    time = np.array([float(row["time"]) for row in rows])
    np.testing.assert_allclose([float(r["j6"]) for r in rows], swing(time)[0][:, 5], atol=1e-9)
    assert float(rows[200]["j6_velocity"]) == pytest.approx(swing(time)[1][200, 5], abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--to", "urscript", "--rate", "501"], "up to 500 Hz"),
        (["--to", "krl-rsi", "--rate", "500"], "up to 250 Hz"),
        (["--to", "urscript", "--rate", "300"], "cycle of 2 ms"),
        (["--to", "csv", "--rate", "0"], "above 0"),
        (["--to", "csv", "--rate", "nan"], "above 0"),
        (["--to", "mjcf"], "with the formats abb-egm, csv, fanuc-stream, krl-rsi"),
        (["--to", "abb"], "Allowed: abb-egm, csv"),
        # Another maker's arm takes no pulses.
        (["--to", "yaskawa-job", "--pulses", "1,2"], "run on arms of Yaskawa"),
        (["--to", "yaskawa-job", "--pulses", "a"], "separated by commas"),
        (["--to", "csv", "--pulses", "1"], "CSV takes no pulses"),
    ],
)
def test_values_outside_a_format_are_refused(folder, arguments, words, capsys):
    assert run(["export", str(folder), *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_job_needs_pulses_and_shares_of_speed_need_limits(folder, capsys):
    write_result_of_arm(folder, "yaskawa-job")
    assert run(["export", str(folder), "--to", "yaskawa-job"]) == 2
    assert "Give the pulses per degree of axes S, L, U, R, B and T" in capsys.readouterr().err
    for wrong in ("1,2", "1,2,3,0,5,6"):
        assert run(["export", str(folder), "--to", "yaskawa-job", "--pulses", wrong]) == 2
        assert f"--pulses {wrong}: give 6 numbers" in capsys.readouterr().err
    stored = read_motion(folder)
    robot = replace(stored.problem.robot, velocity_max=np.full(6, np.inf))
    unlimited = replace(stored, problem=replace(stored.problem, robot=robot))
    with pytest.raises(ValueError, match="has no velocity limit"):
        FORMATS["yaskawa-job"].with_pulses(PULSES).export(unlimited)


@pytest.mark.parametrize("name", ["urscript", "krl-rsi"])
def test_controllers_of_six_axes_refuse_other_arms(folder, name):
    write_result_of_arm(folder, name)
    stored = read_motion(folder)
    other = replace(stored, joint_names=stored.joint_names[:2], prismatic=np.zeros(2, dtype=bool))
    with pytest.raises(ValueError, match="6 turning joints"):
        FORMATS[name].export(other)


def test_link_export_without_planned_links_is_refused(folder):
    path = folder / "trajectory.csv"
    with path.open(newline="") as stream:
        rows = [row[:-6] for row in csv.reader(stream)]
    write_csv(path, rows[0], rows[1:])
    seal(folder)
    with pytest.raises(ValueError, match="no separate link motion"):
        read_motion(folder, "link")


def test_angles_beyond_two_pi_are_refused_for_universal_robots(folder):
    far = FAR * np.array([1, 1, 1, 1, 1, 1.1])
    write_stated(folder, far)
    write_motion(folder, far)
    seal(folder)
    with pytest.raises(ValueError, match=r"joint 6 \(\w+\) reaches 6\.6 rad"):
        FORMATS["urscript"].export(read_motion(folder))


def test_motion_beyond_a_limit_is_not_exported(folder, capsys):
    seal(folder, assessment=assessment(6, DURATION, excess=0.02))
    assert run(["export", str(folder), "--to", "csv"]) == 2
    assert "exceeds torque by 2.00%" in capsys.readouterr().err


def test_results_without_joint_names_are_refused(folder, capsys):
    path = folder / "result.json"
    document = json.loads(path.read_text())
    del document["joints"]
    path.write_text(json.dumps(document))
    assert run(["export", str(folder), "--to", "csv"]) == 2
    assert "does not name its joints" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "maker"),
    [
        ("staubli_rx160", "Staubli"),
        ("tx2_60l", "Staubli"),
        ("mh5", "Yaskawa"),
        ("m10ia", "Fanuc"),
        ("xarm7", "UFACTORY"),
        ("j2s7s300", "Kinova"),
        ("matrix10", ""),
        ("spline2", ""),
    ],
)
def test_the_maker_of_an_arm_is_told_by_its_name(name, maker):
    assert maker_of(name) == maker
