"""Logs of servos: commands in a file of their own, loads that are no torque, notes beside them."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.discovery.sanity.command_doubts import _doubt_swapped, find_lag
from stiffopt.discovery.sanity.sensor_doubts import doubt_magnitudes
from stiffopt.recording.recording_set import load_recordings
from stiffopt.robot.files import load_robot
from stiffopt.starter.column_names import order_by_joint
from stiffopt.starter.guessing import guess_columns

URDF = ROOT / "problems" / "recordings" / "two_link_friction" / "robot.urdf"
ROBOT = load_robot(URDF)
TIME = np.arange(0.0, 12.0, 0.02)
Q = np.column_stack([np.sin(TIME), 0.5 * np.cos(1.3 * TIME), 0.1 * np.sin(TIME)])
COMMAND = Q + 0.02 * np.column_stack([np.cos(TIME), np.sin(1.3 * TIME), np.cos(TIME)])
LOAD = np.column_stack([np.cos(3.0 * TIME), np.sin(2.0 * TIME)])


def servo_table(load: np.ndarray) -> dict[str, np.ndarray]:
    table = {"t": TIME}
    for name, values in (("goal_position", COMMAND), ("present_position", Q), ("load", load)):
        table |= {f"{name}_{j}": values[:, j] for j in range(2)}
    return table


def write_lists(path, **signals):
    """Write a table whose cells are lists, of a gripper besides."""
    rows = [",".join(["kind", "timestamp", *signals])]
    for k, t in enumerate(TIME):
        cells = (f'"{values[k].tolist()}"' for values in signals.values())
        rows.append(",".join(["ROW", f"{1e6 * t:.3f}", *cells]))
    path.write_text("\n".join(rows), encoding="utf-8")


@pytest.mark.parametrize(
    ("load", "told"),
    [
        (0.0 * LOAD, "never changes"),
        (np.round(np.maximum(np.abs(LOAD) - 0.1, 0.0), 2), "never negative"),
        (np.round(900.0 * LOAD), "whole numbers"),
    ],
)
def test_loads_that_are_no_torque_leave_their_place_to_commands(load, told):
    found = guess_columns(servo_table(load), ROBOT)
    assert "torque" not in found.columns
    assert found.columns["command"] == ("goal_position_0", "goal_position_1")
    assert any(told in reason for reason in found.reasons)


def test_torques_and_currents_keep_their_place_beside_commands():
    assert "command" not in guess_columns(servo_table(3.0 * LOAD), ROBOT).columns
    table = servo_table(np.round(900.0 * LOAD))
    named = {name.replace("load", "present_current"): own for name, own in table.items()}
    assert guess_columns(named, ROBOT).units["torque"] == "A"


def test_magnitudes_without_commands_are_doubted():
    recordings = load_recordings(URDF.parent)
    runs = [recordings.open(entry) for entry in recordings.with_role("train")[:2]]
    assert not any(doubt_magnitudes(runs))
    for each in runs:
        each.torque[:] = np.maximum(np.abs(each.torque) - 0.05, 0.0)
    (doubt,) = doubt_magnitudes(runs)
    assert "without a sign" in doubt.evidence


@pytest.mark.parametrize(
    ("first", "expected"), [(0, ("q[0]", "q[1]")), (1, ("q[1]", "q[2]"))]
)  # fmt: skip
def test_joints_are_counted_from_the_first_column(first, expected):
    """Columns after those of the arm are of its gripper."""
    assert order_by_joint([f"q[{k}]" for k in range(first, 3)], ("a", "b")) == expected


def test_commands_beside_states_and_notes_are_one_run_a_folder(tmp_path, capsys):
    for name in ("slow", "fast"):
        folder = tmp_path / name
        folder.mkdir()
        write_lists(folder / "control.csv", positions=COMMAND)
        write_lists(folder / "state.csv", positions=Q, torques=np.abs(Q) - np.abs(Q).min(axis=0))
        (folder / "event.csv").write_text("kind,timestamp,event\nEVENT,0,START\nEVENT,9,END\n")
        (folder / "joints.txt").write_text("shoulder\nelbow\n")
    out = tmp_path / "set"
    folders = [str(tmp_path / name) for name in ("slow", "fast")]
    assert run(["init", "recording", *folders, "--urdf", str(URDF), "--out", str(out)]) == 0
    assert "without rows of numbers are left out: event.csv, joints.txt" in capsys.readouterr().out
    content = tomllib.loads((out / "recordings.toml").read_text())
    assert content["signals"]["position"] == ["positions[0]", "positions[1]"]
    assert content["signals"]["command"] == ["control.positions[0]", "control.positions[1]"]
    assert [each["file"] for each in content["runs"]] == ["slow.npz", "fast.npz"]


def test_a_note_that_is_given_as_a_recording_is_refused(tmp_path, capsys):
    (tmp_path / "event.csv").write_text("kind,event\nEVENT,START\nEVENT,END\n")
    assert run(["init", "recording", str(tmp_path / "event.csv"), "--urdf", str(URDF)]) == 2
    assert "holds no row of numbers" in capsys.readouterr().err
    assert run(["init", "recording", str(tmp_path), "--urdf", str(URDF)]) == 2
    assert "nor do the files beside it" in capsys.readouterr().err


def test_guessed_limits_contradict_no_recording(tmp_path, capsys):
    """A pendulum that turns round lies beyond limits that a URDF lacks."""
    turning = (
        '<robot name="p"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 -0.4"/>'
    )
    turning += (
        '<mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    )
    turning += '</inertial></link><joint name="j" type="revolute"><parent link="base"/>'
    turning += '<child link="arm"/><axis xyz="1 0 0"/><limit lower="0" upper="0" effort="9"'
    turning += ' velocity="20"/></joint></robot>'
    (tmp_path / "arm.urdf").write_text(turning)
    angle = 15.0 * np.sin(0.7 * TIME) + 0.4 * np.sin(3.0 * TIME)
    speed = np.gradient(angle, TIME)
    torque = 0.17 * np.gradient(speed, TIME) + 3.924 * np.sin(angle) + 0.2 * np.sign(speed)
    for name in ("one", "two"):
        table = np.column_stack([TIME, angle, speed, torque])
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header="t,q,qd,tau", comments="")
    logs = [str(tmp_path / name) for name in ("one.csv", "two.csv")]
    out = str(tmp_path / "set")
    assert run(["init", "recording", *logs, "--urdf", str(tmp_path / "arm.urdf"), "-o", out]) == 0
    assert run(["recording", "check", out]) == 0
    assert "look like degrees" not in capsys.readouterr().out


def test_joints_that_stand_in_a_run_do_not_lead_their_commands():
    """Logs of one joint at a time: commands that do not change have no lag."""
    recordings = load_recordings(URDF.parent)
    first = recordings.open(recordings.with_role("train")[0])
    rows = len(first.time)
    late = np.roll(first.position[:, 0], -6)  # the position is six rows later
    runs = []
    for joint in range(2):
        command, position = np.zeros((2, rows, 2))
        command[:, joint], position[:, joint] = late, first.position[:, 0]
        position[:, 1 - joint] = 1e-4 * (np.arange(rows) % 2)
        runs.append(replace(first, command=command, position=position))
    (lags, weights) = find_lag(runs[0])
    assert lags[0] == pytest.approx(6.0 * first.step, abs=1.5 * first.step)
    assert weights[0] > 0.0
    assert weights[1] == 0.0
    assert not list(_doubt_swapped(recordings, runs, np.ones(2, dtype=bool)))
    swapped = [replace(run, command=run.position, position=run.command) for run in runs]
    assert len(list(_doubt_swapped(recordings, swapped, np.ones(2, dtype=bool)))) == 1
