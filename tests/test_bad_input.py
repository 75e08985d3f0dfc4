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
    URDFS,
    joint,
    problem_text,
    reducer,
    write_problem,
    write_robot,
)

from stiffopt.cli import run

SAME = {
    "start": "{ joints = [-0.6, 0.4] }",
    "end": "{ joints = [0.5, 0.2] }",
}


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
    "unknown key": (
        {"motion": "boundary_velocty = 'zero'"},
        ["motion.boundary_velocty", "Did you mean 'boundary_velocity'?"],
    ),
    "unknown section": (
        {"extra": "[paylod]\nmass = 1"},
        ["paylod", "Did you mean 'payload'?"],
    ),
    "unknown key of a target": (
        {"start": "{ joint = [0, 0] }"},
        ["motion.start.joint", "Did you mean 'joints'?"],
    ),
    "wrong unit": ({"duration": "'0.5 m'"}, ["motion.duration", "0.5 m", "time"]),
    "unknown unit": ({"duration": "'0.5 secnds'"}, ["motion.duration", "secnds", "time"]),
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
        ["motion.end.position", "3 items"],
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
        ["limits.joint_stiffness.1", "greater than 0"],
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
        ["minimise[1].joints", "greater than or equal to 1"],
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
        ["minimise[1].weight", "greater than 0"],
    ),
    "intervals too few": ({"method": "intervals = 2"}, ["method.intervals", "4", "got 2"]),
    "intervals too many": ({"method": "intervals = 100000"}, ["method.intervals", "2000"]),
    "half an interval": ({"method": "intervals = 20.5"}, ["method.intervals", "integer"]),
    "unknown transcription": (
        {"method": 'transcription = "hermite-simpson"'},
        ["method.transcription", "Did you mean 'hermite_simpson'?"],
    ),
    "time limit of zero": ({"method": "time_limit = 0"}, ["method.time_limit", "greater than 0"]),
    "duration of zero": ({"duration": "0.0"}, ["motion.duration", "greater than 0"]),
    "negative duration": ({"duration": "'-0.5 s'"}, ["motion.duration", "greater than 0"]),
    "duration upside down": (
        {"duration": "{ lower = 2.0, upper = 1.0 }"},
        ["motion.duration", "lower", "upper"],
    ),
    "duration of 1e300": ({"duration": "1e300"}, ["motion.duration", "1e"]),
    "duration of 1e-300": ({"duration": "1e-300"}, ["motion.duration", "1e-"]),
    "joint angle of 1e300": (
        {"start": "{ joints = [1e300, 0] }"},
        ["motion.start", "joint 1", "outside its range"],
    ),
    "position of 1e300": ({"end": "{ position = [1e300, 0, 0] }"}, ["motion.end", "out of reach"]),
    "negative payload": ({"extra": "[payload]\nmass = '-1 kg'"}, ["payload.mass", "or equal to 0"]),
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
        ["motion.via[1]", "tolerance", "greater than zero"],
    ),
    "boundary velocity above its limit": (
        {"motion": "boundary_velocity = { start = [9.0, 0.0], end = [0.0, 0.0] }"},
        ["boundary_velocity.start", "joint 1", "9", "6"],
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
    path = write_problem(tmp_path, pieces.pop("robot", "planar") if 0 else "planar", **{
        k: v for k, v in pieces.items() if k != "robot"
    })
    if "robot" in pieces:
        path.write_text(path.read_text().replace('"planar.toml"', f'"{pieces["robot"]}"'))
    message = solve(capsys, tmp_path, path, *parts)
    assert path.name in message or "robot" in pieces or "map.csv" in message
