"""Wrong input through the command line: one message, exit code 2, nothing written."""

import os
import re
import subprocess
import sys

import pytest
from small_arms import (
    CONSTANT,
    JOINTS,
    PLANAR,
    joint,
    reducer,
    write_problem,
    write_robot,
)

from stiffopt.cli import run


def refused(capsys, tmp_path, arguments, *parts):
    """Run a command line that must fail; its message, which must hold all parts."""
    before = sorted(p for p in tmp_path.rglob("*"))
    code = run([str(a) for a in arguments])
    streams = capsys.readouterr()
    message = streams.err
    assert code == 2, message + streams.out
    assert streams.out == ""
    assert message.startswith("stiffopt: ")
    assert "Traceback" not in message
    assert "pydantic" not in message
    assert "Error" not in message
    for part in parts:
        assert part in message, message
    # Nothing appears, not even an empty folder for the results.
    assert sorted(p for p in tmp_path.rglob("*")) == before
    return message


def solve(capsys, tmp_path, path, *parts):
    out = tmp_path / "out" / "deep"
    return refused(capsys, tmp_path, ["solve", path, "--out", out, "--quiet"], *parts)


# Pieces of a planar problem, and what the message must say: place, cause, what is allowed.
PROBLEMS = {
    "an uncertainty that takes all stiffness": (
        {"extra": "[uncertainty]\nstiffness = 1.2"},
        ["uncertainty", "stiffness = 1.2", "zero or negative", "below 1"],
    ),
    "an uncertainty that makes damping negative": (
        {"extra": "[uncertainty]\ndamping = 1.5"},
        ["uncertainty", "damping = 1.5", "negative", "from 0 to 1"],
    ),
    "stiffness uncertain for more joints than there are": (
        {"extra": "[uncertainty]\nstiffness = [0.1, 0.2, 0.1]"},
        ["uncertainty.stiffness has 3 numbers", "2 joints"],
    ),
    "a servo that is not stable": (
        {"extra": "[uncertainty]\nservo_delay = '20 ms'"},
        ["uncertainty", "the servo is unstable", "needs a delay below 13.96 ms"],
    ),
    "a frequency in another unit": (
        {"extra": "[uncertainty]\nservo_bandwidth = '20 mm'"},
        ["uncertainty.servo_bandwidth", "20 mm", "frequency"],
    ),
    "unknown key": (
        {"motion": "boundary_velocty = 'zero'"},
        ["motion.boundary_velocty", "Did you mean 'boundary_velocity'?"],
    ),
    "unknown section": (
        {"extra": "[paylod]\nmass = 1"},
        ["paylod", "Did you mean 'payload'?", "robot, schema, servo,"],
    ),
    "unknown key of a target": (
        {"start": "{ joint = [0, 0] }"},
        ["motion.start.joint", "Did you mean 'joints'?"],
    ),
    "wrong unit": ({"duration": "'0.5 m'"}, ["motion.duration", "0.5 m", "time"]),
    "unknown unit": ({"duration": "'0.5 secnds'"}, ["motion.duration", "secnds", "1.6 s"]),
    "no unit": ({"duration": "'0.5'"}, ["motion.duration", "no unit"]),
    "length for an angle": (
        {"start": "{ joints = ['1 mm', 0.1] }"},
        ["motion.start.joints[1]", "revolute", "needs angle, got length"],
    ),
    "start outside the joint range": (
        {"start": "{ joints = ['200 deg', 0.0] }"},
        ["motion.start", "joint 1", "200 deg", "outside its range", "-171.9 deg"],
    ),
    "end outside the joint range": (
        {"end": "{ joints = [0.0, -3.5] }"},
        ["motion.end", "joint 2", "outside its range"],
    ),
    "via outside the joint range": (
        {"motion": "via = [{ joints = [0.0, 4.0], tolerance = 0.01 }]"},
        ["motion.via[1]", "joint 2", "outside its range"],
    ),
    "a pose that the drives cannot hold": (
        {"limits": "torque = [3.0, 60.0]"},
        ["motion.start", "joint 1", "torque limit 3 N m", "no duration"],
    ),
    "an end that the drives cannot hold": (
        {"start": "{ joints = [-1.57, 0.0] }", "limits": "torque = [5.0, 60.0]"},
        ["motion.end", "joint 1", "torque limit 5 N m", "no duration"],
    ),
    "position out of reach": (
        {"end": "{ position = [0.9, 0.0, 0.1] }"},
        ["motion.end", "0.9", "reach"],
    ),
    "pose out of the plane": (
        {"end": "{ position = [0.5, 0.2, 0.1] }"},
        ["motion.end", "reach"],
    ),
    "joints and position": (
        {"end": "{ joints = [0, 0], position = [0.5, 0, 0] }"},
        ["motion.end", "either `joints` or `position`"],
    ),
    "neither joints nor position": (
        {"end": "{ tolerance = 0.1 }"},
        ["motion.end", "either `joints` or `position`"],
    ),
    "too many joint angles": (
        {"start": "{ joints = [0, 0, 0] }"},
        ["motion.start.joints", "2 values", "got 3", "shoulder, elbow"],
    ),
    "too few joint velocities": (
        {"motion": "boundary_velocity = { start = [0.1], end = [0.0, 0.0] }"},
        ["boundary_velocity.start", "2 values", "got 1"],
    ),
    "too few limits": ({"limits": "velocity = [1.0]"}, ["limits.velocity", "2 values", "got 1"]),
    "two numbers for a position": (
        {"end": "{ position = [0.5, 0.1] }"},
        ["motion.end.position[3]", "missing"],
    ),
    "a limit of zero": (
        {"limits": "velocity = [0.0, 1.0]"},
        ["limits.velocity", "greater than zero"],
    ),
    "a negative limit": (
        {"limits": "acceleration = [-5.0, 1.0]"},
        ["limits.acceleration", "greater than zero"],
    ),
    "a range upside down": (
        {"limits": "position_lower = [1.0, 0.0]\nposition_upper = [0.0, 1.0]"},
        ["limits", "position_lower", "below", "joint 1"],
    ),
    "stiffness floor of an unknown joint": (
        {"limits": "joint_stiffness = { 7 = 1e3 }"},
        ["limits.joint_stiffness", "no joint 7", "1 to 2"],
    ),
    "a negative stiffness floor": (
        {"limits": "joint_stiffness = { 1 = -1e3 }"},
        ["limits.joint_stiffness.1", "above 0"],
    ),
    "a floor that a rest pose rules out": (
        {"limits": "joint_stiffness = { 2 = 1e6 }"},
        ["limits.joint_stiffness", "joint 2", "start pose", "whatever the motion"],
    ),
    "a cap below the sag": (
        {"limits": "total_deflection = '0.1 mm'"},
        ["limits.total_deflection", "static sag", "0.1 mm", "dynamic_deflection"],
    ),
    "joint number 0": (
        {"minimise": 'objective = "mean_compliance"\njoints = [0]'},
        ["minimise[1].joints", "1 or above"],
    ),
    "joint number above n": (
        {"minimise": 'objective = "mean_compliance"\njoints = [3]'},
        ["minimise[1].joints", "no joint 3", "1 to 2"],
    ),
    "joint weight of no joint": (
        {"minimise": 'objective = "joint_stiffness"\njoint_weights = { 4 = 2.0 }'},
        ["minimise[1].joint_weights", "no joint 4", "1 to 2"],
    ),
    "unknown objective": (
        {"minimise": 'objective = "dynamic_deflexion"'},
        ["minimise[1].objective", "Did you mean 'dynamic_deflection'?", "duration"],
    ),
    "unknown measure": (
        {"minimise": 'objective = "dynamic_deflection"\nmeasure = "mean"'},
        ["minimise[1].measure", "peak", "rms"],
    ),
    "a weight of zero": (
        {"minimise": 'objective = "duration"\nweight = 0.0'},
        ["minimise[1].weight", "above 0"],
    ),
    "intervals too few": ({"method": "intervals = 2"}, ["method.intervals", "4", "intervals = 2"]),
    "intervals too many": ({"method": "intervals = 100000"}, ["method.intervals", "2000"]),
    "half an interval": ({"method": "intervals = 20.5"}, ["method.intervals", "integer"]),
    "unknown transcription": (
        {"method": 'transcription = "hermite-simpson"'},
        ["method.transcription", "Did you mean 'hermite_simpson'?"],
    ),
    "time limit of zero": ({"method": "time_limit = 0"}, ["method.time_limit", "above 0"]),
    "duration of zero": ({"duration": "0.0"}, ["motion.duration", "above 0"]),
    "negative duration": ({"duration": "'-0.5 s'"}, ["motion.duration", "above 0"]),
    "duration upside down": (
        {"duration": "{ lower = 2.0, upper = 1.0 }"},
        ["motion.duration", "lower", "upper"],
    ),
    "duration of 1e300": ({"duration": "1e300"}, ["motion.duration", "1e"]),
    "duration of 1e-300": ({"duration": "1e-300"}, ["motion.duration", "1e-"]),
    "joint angle of 1e300": (
        {"start": "{ joints = [1e300, 0] }"},
        ["motion.start.joints[1]", "1e+300", "at most 1e+15"],
    ),
    "position of 1e9": (
        {"end": "{ position = [1e9, 0, 0] }"},
        ["motion.end", "1e+09 m is not plausible"],
    ),
    "negative payload": ({"extra": "[payload]\nmass = '-1 kg'"}, ["payload.mass", "0 or above"]),
    "payload of 1e300": ({"extra": "[payload]\nmass = 1e300"}, ["payload.mass", "1e+300"]),
    "impossible inertia": (
        {"extra": "[payload]\nmass = 1\ninertia = [1e-3, 1e-3, 1.0]"},
        ["payload", "belong to no body"],
    ),
    "inertia of four numbers": (
        {"extra": "[payload]\nmass = 1\ninertia = [1e-3, 1e-3, 1e-3, 0.0]"},
        ["payload.inertia", "3 items"],
    ),
    "unknown tool link": ({"extra": "[tool]\nlink = 'tipp'"}, ["tool", "Did you mean 'tip'?"]),
    "negative tolerance": (
        {"motion": "via = [{ joints = [0, 0.2], tolerance = -1.0 }]"},
        ["motion.via[1]", "tolerance", "above 0"],
    ),
    "boundary velocity above its limit": (
        {"motion": "boundary_velocity = { start = [9.0, 0.0], end = [0.0, 0.0] }"},
        ["boundary_velocity.start", "joint 1", "9", "6"],
    ),
    "boundary velocity too near to a position limit": (
        {
            "motion": "boundary_velocity = { start = [5.9, 0.0], end = [0.0, 0.0] }",
            "limits": "acceleration = [4.0, 60.0]",
        },
        ["boundary_velocity.start", "joint 1", "brake", "position limit"],
    ),
    "a path with other ends": (
        {"motion": "path = [[0, 0], [0.1, 0.1], [0.2, 0.2], [0.3, 0.3]]"},
        ["motion", "`path` fixes start"],
    ),
    "wrong kind": ({"head": 'schema = 1\nkind = "robot"'}, ["kind", "trajectory", "robot"]),
    "no kind": ({"head": "schema = 1"}, ["kind", "missing"]),
    "wrong schema": ({"head": 'schema = 2\nkind = "trajectory"'}, ["schema = 1", "2"]),
    "no schema": ({"head": 'kind = "trajectory"'}, ["schema", "missing"]),
    "unknown robot": ({"robot": "er3a_c6"}, ["robot", "Did you mean 'er3a_c60'?"]),
    "missing robot file": ({"robot": "absent.toml"}, ["absent.toml", "no such file"]),
    "missing speed map": (
        {"limits": 'velocity_by_position = "map.csv"'},
        ["map.csv", "no such file"],
    ),
    "expected without a source": (
        {"limits": "[expected]\nobjective = 1.0\nunit = 's'"},
        ["expected.source", "required"],
    ),
    "expected in an unknown unit": (
        {"limits": "[expected]\nobjective = 1.0\nunit = 'furlong stone'\nsource = 'exact'"},
        ["expected.unit", "furlong stone"],
    ),
    "expected in a unit of another kind": (
        {"limits": "[expected]\nobjective = 1.0\nunit = 'mm'\nsource = 'exact'"},
        ["expected.unit", "mm"],
    ),
}


@pytest.mark.parametrize("case", PROBLEMS)
def test_wrong_problem_file(case, tmp_path, capsys):
    pieces, parts = PROBLEMS[case]
    robot = pieces.get("robot")
    path = write_problem(tmp_path, **{k: v for k, v in pieces.items() if k != "robot"})
    if robot:
        path.write_text(path.read_text().replace('"planar.toml"', f'"{robot}"'))
    message = solve(capsys, tmp_path, path, *parts)
    assert any(name in message for name in ("problem.toml", "absent.toml", "map.csv"))


def test_no_objective(tmp_path, capsys):
    path = write_problem(tmp_path)
    whole = path.read_text()
    path.write_text(whole.replace('objective = "torque_squared"', ""))
    solve(capsys, tmp_path, path, "minimise[1].objective", "required")
    path.write_text("minimise = []\n" + whole.replace("[[minimise]]\n", "[unused]\n"))
    solve(capsys, tmp_path, path, "minimise", "1 item")


def test_toml_syntax(tmp_path, capsys):
    path = write_problem(tmp_path)
    path.write_text(path.read_text().replace("duration = 0.5", "duration = 0.5 s"))
    line = 1 + path.read_text().splitlines().index("duration = 0.5 s")
    solve(capsys, tmp_path, path, f"line {line}", "not valid TOML")
    path.write_bytes(b"\xff\xfe\x00")
    solve(capsys, tmp_path, path, "not UTF-8")


def test_missing_file(tmp_path, capsys):
    write_problem(tmp_path)
    solve(capsys, tmp_path, tmp_path / "problm.toml", "problm.toml", "no such file", "problem.toml")
    solve(capsys, tmp_path, tmp_path / "absent" / "a.toml", "there is no folder")
    solve(capsys, tmp_path, tmp_path, "is a folder")


MAP_HEAD = "q1,v1,q2,v2"
MAPS = {
    "a missing column": (["q1,v1,q2", "-3,1,-3", "3,1,3"], ["q1, q2, v1, v2"]),
    "one row": ([MAP_HEAD, "-3,1,-3,1"], ["at least two rows"]),
    "nan": ([MAP_HEAD, "-3,1,-3,1", "3,nan,3,1"], ["v1", "nan", "row 2"]),
    "infinity": ([MAP_HEAD, "-3,1,-3,1", "inf,1,3,1"], ["q1", "inf", "row 2"]),
    "text": ([MAP_HEAD, "-3,1,-3,fast", "3,1,3,1"], ["v2", "fast", "row 1"]),
    "too few values": ([MAP_HEAD, "-3,1,-3", "3,1,3,1"], ["v2", "row 1"]),
    "positions that fall": ([MAP_HEAD, "3,1,-3,1", "-3,1,3,1"], ["q1", "increase"]),
    "no speed": ([MAP_HEAD, "-3,1,-3,0", "3,1,3,1"], ["v2", "greater than zero"]),
}


@pytest.mark.parametrize("case", MAPS)
def test_wrong_speed_map(case, tmp_path, capsys):
    rows, parts = MAPS[case]
    path = write_problem(tmp_path, limits='velocity_by_position = "map.csv"')
    (tmp_path / "map.csv").write_text("\n".join(rows) + "\n")
    solve(capsys, tmp_path, path, "map.csv", *parts)


# Robot files: the joints in place of the right ones, or a change of the URDF.
ELBOW = JOINTS["planar"][1]


def broken(element, **numbers):
    return [joint("shoulder", element, **numbers), ELBOW]


ROBOTS = {
    "negative stiffness": (broken(CONSTANT.format(stiffness=-1e4)), ["spring", "stiffness"]),
    "stiffness of zero": (broken(CONSTANT.format(stiffness=0.0)), ["spring", "stiffness"]),
    "T2 below T1": (broken(reducer(t1=25.0, t2=7.0)), ["reducer", "T1", "T2"]),
    "negative K1": (broken(reducer(k1=-8e3)), ["reducer", "K1"]),
    "stiffness in N m": (
        broken(CONSTANT.format(stiffness="'100 N*m'")),
        ["joint[shoulder].element[spring].stiffness", "100 N*m", "N*m/arcmin"],
    ),
    "unknown element": (
        broken(CONSTANT.format(stiffness=1e4).replace("constant", "konstant")),
        ["joint[shoulder].element[spring].type", "Did you mean 'constant'?"],
    ),
    "unknown key of an element": (
        broken(CONSTANT.format(stiffness=1e4) + "stifness = 2.0"),
        ["joint[shoulder].element[spring].stifness", "Did you mean 'stiffness'?"],
    ),
    "unknown joint": (
        [JOINTS["planar"][0].replace("shoulder", "sholder"), ELBOW],
        ["sholder", "Did you mean 'shoulder'?"],
    ),
    "torque limit of zero": (broken(reducer(), torque_max=0.0), ["torque_max", "above 0"]),
    "negative rotor inertia": (broken(reducer(), rotor_inertia=-0.1), ["rotor_inertia"]),
}


@pytest.mark.parametrize("case", ROBOTS)
@pytest.mark.parametrize("command", ["solve", "stiffness"])
def test_wrong_robot_file(case, command, tmp_path, capsys):
    joints, parts = ROBOTS[case]
    path = write_problem(tmp_path)
    robot = write_robot(tmp_path, joints=joints)
    if command == "solve":
        solve(capsys, tmp_path, path, "planar.toml", *parts)
    else:
        out = tmp_path / "out"
        refused(capsys, tmp_path, ["stiffness", robot, "--out", out], "planar.toml", *parts)


SURFACE = """
[surface.odd]
first = "steel"
second = "steel"
fractal_dimension = {dimension}
fractal_roughness = {roughness}
"""
KEYED = """[[joint.element]]
name = "key"
type = "key"
shaft_diameter = "30 mm"
width = "8 mm"
height = "7 mm"
length = "40 mm"
surface = "odd"
"""


@pytest.mark.parametrize(
    ("dimension", "roughness", "parts"),
    [
        (3.2, 1e-11, ["fractal_dimension", "3.2", "2", "3"]),
        (1.8, 1e-11, ["fractal_dimension", "1.8"]),
        (2.5, -1e-11, ["fractal_roughness"]),
        (2.5, 0.0, ["fractal_roughness"]),
    ],
)
def test_surface_outside_its_validity(dimension, roughness, parts, tmp_path, capsys):
    path = write_problem(tmp_path)
    joints = [joint("shoulder", KEYED), ELBOW]
    surface = SURFACE.format(dimension=dimension, roughness=roughness)
    write_robot(tmp_path, joints=[*joints, surface])
    solve(capsys, tmp_path, path, "planar.toml", *parts)


URDF_CHANGES = {
    "floating joint": ('type="revolute"', 'type="floating"', ["shoulder", "floating", "revolute"]),
    "planar joint": ('type="revolute"', 'type="planar"', ["shoulder", "planar", "prismatic"]),
    "mimic": (
        '<axis xyz="0 1 0"/>',
        '<axis xyz="0 1 0"/><mimic joint="elbow"/>',
        ["shoulder", "mimic"],
    ),
    "nan": ('<mass value="2.0"/>', '<mass value="nan"/>', ["upper", "mass", "nan"]),
    "negative mass": ('<mass value="2.0"/>', '<mass value="-2"/>', ["upper", "mass", "-2"]),
    "no axis": ('xyz="0 1 0"', 'xyz="0 0 0"', ["shoulder", "axis"]),
    "unknown link": (
        '<child link="fore"/>',
        '<child link="for"/>',
        ["elbow", "child", "Did you mean 'fore'?"],
    ),
    "no xml": ('<robot name="arm">', "<robot", ["planar.urdf", "not a URDF"]),
}


@pytest.mark.parametrize("case", URDF_CHANGES)
def test_wrong_urdf(case, tmp_path, capsys):
    old, new, parts = URDF_CHANGES[case]
    path = write_problem(tmp_path)
    assert old in PLANAR
    write_robot(tmp_path, urdf_text=PLANAR.replace(old, new, 1))
    solve(capsys, tmp_path, path, "planar.urdf", *parts)


# Every key that takes a number, in one file; each becomes nan and infinite in turn.
FULL = """schema = 1
kind = "trajectory"
robot = "planar.toml"
[payload]
mass = 1.0
com = [0.0, 0.0, 0.05]
inertia = [1e-3, 1e-3, 1e-3]
[tool]
link = "tip"
offset = [0.1, 0.0, 0.0]
process_force = [0.0, 0.0, 1.0]
[motion]
start = { joints = [-0.6, 0.4] }
via = [{ position = [0.6, 0.0, 0.2], tolerance = 0.01, near = [0.0, 0.3] }]
end = { position = [0.6, 0.0, 0.1], rpy = [0.0, 0.5, 0.0], angle_tolerance = 0.02 }
duration = { lower = 0.4, upper = 0.8 }
boundary_velocity = { start = [0.1, 0.0], end = [0.0, 0.1] }
[[minimise]]
objective = "joint_stiffness"
weight = 1.5
joints = [1]
joint_weights = { 1 = 2.5 }
[limits]
position_lower = [-2.0, -2.0]
position_upper = [2.0, 2.0]
velocity = [5.0, 5.0]
acceleration = [50.0, 50.0]
jerk = [900.0, 900.0]
torque = [55.0, 55.0]
scale = { velocity = 0.9, acceleration = 0.9, jerk = 0.9, torque = 0.9 }
tool_speed = 3.0
dynamic_deflection = 0.01
total_deflection = 0.02
joint_stiffness = { 1 = 100.0 }
[method]
intervals = 20
time_limit = 60.0
max_iterations = 100
starts = 1
tolerance = 1e-8
seed = 3
[expected]
objective = 1.0
unit = "N m/rad"
rtol = 1e-3
source = "exact"
"""
NUMBERS = [m.span() for m in re.finditer(r"(?<=[ =\[])-?\d+\.?\d*(?:e-?\d+)?(?=[,\] \n])", FULL)]
# `schema` is checked before; the numbers in front of `=` are keys.
NUMBERS = [span for span in NUMBERS[1:] if not FULL[span[1] :].startswith(" =")]


def test_nan_and_infinity_anywhere(tmp_path, capsys):
    write_robot(tmp_path)
    path = tmp_path / "problem.toml"
    assert len(NUMBERS) == 65
    for begin, end in NUMBERS:
        for value in ("nan", "inf", "-inf"):
            text = FULL[:begin] + value + FULL[end:]
            path.write_text(text)
            key = FULL[:begin].splitlines()[-1].split(" = ")[0]
            message = solve(capsys, tmp_path, path, "problem.toml", key)
            assert re.search(r"finite|integer", message), (key, message)


COMMANDS = {
    "unknown command": (["slove", "a.toml"], ["slove", "solve"]),
    "unknown option": (["solve", "a.toml", "--outt", "x"], ["--outt"]),
    "no problem": (["solve"], ["problem", "requires"]),
    "unknown robot": (["stiffness", "er3a_c6"], ["er3a_c6", "Did you mean 'er3a_c60'?"]),
    "absent robot file": (["stiffness", "absent.toml"], ["absent.toml", "no such file"]),
    "unknown kind": (["schema", "sweeps"], ["sweeps", "trajectory", "preload"]),
    "nothing to verify": (["verify", "."], ["no trajectory problem"]),
    "absent folder": (["verify", "absent"], ["absent", "no such file"]),
}


@pytest.mark.parametrize("case", COMMANDS)
def test_wrong_command_line(case, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, parts = COMMANDS[case]
    refused(capsys, tmp_path, arguments, *parts)


def test_verify_reads_all_files_before_it_solves(tmp_path, capsys):
    write_problem(tmp_path, name="a.toml", limits=EXPECTED)
    write_problem(tmp_path, name="b.toml", duration="-1.0", limits=EXPECTED)
    refused(capsys, tmp_path, ["verify", tmp_path], "b.toml", "motion.duration")


EXPECTED = '[expected]\nobjective = 1.0\nunit = "s"\nsource = "exact"'


def test_output_in_the_place_of_a_file(tmp_path, capsys):
    path = write_problem(tmp_path)
    (tmp_path / "out").write_text("mine")
    for out in (tmp_path / "out", tmp_path / "out" / "deeper"):
        refused(capsys, tmp_path, ["solve", path, "--out", out], str(out), "--out")
    assert (tmp_path / "out").read_text() == "mine"


def test_output_that_cannot_be_written(tmp_path, capsys):
    path = write_problem(tmp_path)
    refused(capsys, tmp_path, ["solve", path, "--out", "/proc/stiffopt"], "/proc/stiffopt", "--out")
    if os.geteuid() != 0:
        locked = tmp_path / "locked"
        locked.mkdir(mode=0o500)
        refused(capsys, tmp_path, ["solve", path, "--out", locked], str(locked), "--out")


@pytest.mark.parametrize("duration", ["0.5", "-1.0"])
def test_what_was_there_stays(duration, tmp_path, capsys):
    """A refused problem leaves the results of an earlier run as they were."""
    pieces = {"duration": duration} if duration != "0.5" else {"end": "{ joints = [9, 0] }"}
    path = write_problem(tmp_path, **pieces)
    out = tmp_path / "out"
    out.mkdir()
    (out / "result.json").write_text("{}")
    refused(capsys, tmp_path, ["solve", path, "--out", out])
    assert (out / "result.json").read_text() == "{}"


def test_through_a_real_process(tmp_path):
    path = write_problem(tmp_path, start="{ joints = [-4.0, 0.4] }")
    command = [sys.executable, "-m", "stiffopt", "solve", str(path), "--out", str(tmp_path / "o")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "motion.start: joint 1" in done.stderr
    assert not (tmp_path / "o").exists()
