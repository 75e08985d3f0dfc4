"""Motions changed after their solve, and exported files changed after their export."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import types

import numpy as np
import pytest
from test_export import (
    DURATION,
    FAR,
    seal,
    swing,
    write_motion,
    write_result_of_arm,
    write_stated,
)

from stiffopt.cli import run
from stiffopt.export.format import read_seal, with_seal
from stiffopt.result.store import export_times


@pytest.fixture
def folder(tmp_path):
    write_stated(tmp_path)
    write_motion(tmp_path)
    seal(tmp_path)
    return tmp_path


def spike(rows):
    rows[100, 3] = 1e9
    return rows


def small_spike(rows):
    rows[100, 3] += 0.01
    return rows


def scale_time(rows):
    rows[:, 0] *= 1e-6
    return rows


def scale_joints(rows):
    rows[:, 1:19] *= 0.9
    return rows


def swap_joints(rows):
    rows[:, [1, 2]] = rows[:, [2, 1]]
    return rows


def swap_rates(rows):
    rows[:, 7:13], rows[:, 13:19] = rows[:, 13:19].copy(), rows[:, 7:13].copy()
    return rows


def without_number(rows):
    rows[50, 2] = np.nan
    return rows


def shuffled(rows):
    rows[[40, 41]] = rows[[41, 40]]
    return rows


def shuffled_content(rows):
    rows[[40, 90], 1:] = rows[[90, 40], 1:]
    return rows


def other_sign(rows):
    rows[:, 1:19] *= -1.0
    return rows


TAMPERED = {
    "a spike of 1e9 rad": (spike, "velocity of joint 3"),
    "a spike of 0.01 rad": (small_spike, "velocity of joint 3"),
    "half of the motion": (lambda rows: rows[: len(rows) // 2], "cut or scaled"),
    "every second row": (lambda rows: rows[::2], "rows are missing"),
    "one row removed": (lambda rows: np.delete(rows, 77, axis=0), "rows are missing"),
    "times scaled by 1e-6": (scale_time, "rows are missing or the times were changed"),
    "joints scaled by 0.9": (scale_joints, "exceeds end"),
    "two joints' positions swapped": (swap_joints, "velocity of joint"),
    "velocities and accelerations swapped": (swap_rates, "velocity of joint"),
    "no number": (without_number, "needs a finite number"),
    "two rows swapped": (shuffled, "must start at 0 and increase"),
    "content of two rows swapped": (shuffled_content, "velocity of joint"),
    "all signs turned": (other_sign, "exceeds end"),
    "a row twice": (lambda rows: np.repeat(rows, [1] * 9 + [2] + [1] * (len(rows) - 10), axis=0),
                    "must start at 0 and increase"),
}  # fmt: skip


@pytest.mark.parametrize("case", TAMPERED)
@pytest.mark.parametrize("resealed", [False, True], ids=["as changed", "hash made to fit"])
def test_changed_motion_is_not_exported(folder, case, resealed, capsys):
    change, words = TAMPERED[case]
    write_motion(folder, change=change)
    if resealed:
        seal(folder)
    assert run(["export", str(folder), "--to", "csv"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert (words if resealed or "finite" in words else "has another hash of it") in said
    assert not (folder / "motor.csv").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mass": 9}, "the payload of"),
        ({"robot": "er3a_c60"}, "the robot of"),
        ({"velocity": 20}, "the limits of"),
        ({"end": [0.5, -1.0, 1.2, -2.0, 0.3, 6.1]}, "differs from the problem solved"),
    ],
)
def test_result_of_other_inputs_is_not_exported(folder, changes, words, capsys):
    write_stated(folder, **changes)
    assert run(["export", str(folder), "--to", "csv"]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("key", ["robot", "payload", "limits", "files", "all"])
def test_result_with_edited_or_missing_seal_is_not_exported(folder, key, capsys):
    path = folder / "result.json"
    document = json.loads(path.read_text())
    if key == "all":
        del document["seal"]
    else:
        document["seal"][key] = {"trajectory.csv": "0" * 64} if key == "files" else "0" * 64
    path.write_text(json.dumps(document))
    assert run(["export", str(folder), "--to", "csv"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_limit_exceeded_by_the_samples_is_reported(folder, capsys):
    fastest = np.max(np.abs(swing(export_times(DURATION))[1][:, 5]))
    write_stated(folder, velocity=0.9 * fastest)
    seal(folder)
    assert run(["export", str(folder), "--to", "csv"]) == 2
    assert "exceeds velocity of joint 6 at 0.226 s by 11.11%" in capsys.readouterr().err


@pytest.mark.parametrize("to", ["csv", "ros2", "urscript", "krl-rsi", "abb-egm"])
def test_an_exported_file_is_checked(folder, to, capsys):
    arm = write_result_of_arm(folder, to)
    out = folder / "out"
    assert run(["export", str(folder), "--to", to, "--out", str(out)]) == 0
    files = [each for each in out.iterdir() if "stiffopt content: " in each.read_text()]
    assert len(files) == (2 if to in ("krl-rsi", "abb-egm") else 1)
    for file in files:
        given = ["check", str(file), "--result", str(folder)]
        assert run(given) == 0
        said = capsys.readouterr().out
        assert f"Motion of the motors of Pick – and place, robot {arm} with 5 kg" in said
        assert "All limits are met; the tightest is position of joint 6" in said
        text = file.read_text(encoding="utf-8")
        entries, body = read_seal(text)
        entries.pop("content")
        digit = max(match.end() for match in re.finditer(r"\.\d", body)) - 1
        changed = f"{body[:digit]}{(int(body[digit]) + 1) % 10}{body[digit + 1 :]}"
        for tampered, words in (
            (
                text.replace(body[digit - 9 :], changed[digit - 9 :]),
                "was changed after its export",
            ),
            (text.replace("rate: ", "rate: 1"), ""),
            (with_seal(changed, entries, file.name), "although its header matches"),
            (body, "has no header"),
        ):
            assert tampered != text
            file.write_text(tampered, encoding="utf-8")
            assert run(given) == 2
            assert words in capsys.readouterr().err


def test_a_job_without_room_for_a_header_is_said_to_have_none(tmp_path, capsys):
    job = tmp_path / "MOVE.JBI"
    assert run(["check", str(job), "--result", str(tmp_path)]) == 2
    assert "no room" not in capsys.readouterr().err
    job.write_text("/JOB\n")
    assert run(["check", str(job), "--result", str(tmp_path)]) == 2
    assert "has no room for the header" in capsys.readouterr().err


def test_file_of_another_result_is_refused(folder, tmp_path_factory, capsys):
    out = tmp_path_factory.mktemp("out")
    assert run(["export", str(folder), "--to", "csv", "--rate", "100", "--out", str(out)]) == 0
    other = tmp_path_factory.mktemp("other")
    write_stated(other, mass=7)
    write_motion(other)
    seal(other)
    file = str(out / "motor.csv")
    assert run(["check", file, "--result", str(other)]) == 2
    assert "its payload is not that of" in capsys.readouterr().err
    assert run(["check", file, "--result", str(tmp_path_factory.mktemp("none"))]) == 2
    assert "Give the folder of its solve as --result" in capsys.readouterr().err


@pytest.mark.parametrize("to", ["urscript", "krl-rsi"])
def test_program_with_an_approach_refuses_a_moving_start(folder, to, capsys):
    write_result_of_arm(folder, to)
    speed = FAR / DURATION
    path = folder / "problem.toml"
    moving = f"boundary_velocity = {{ start = {speed.tolist()}, end = {speed.tolist()} }}\n"
    moving += 'boundary_acceleration = "zero"\n\n[[minimise]]'
    path.write_text(path.read_text().replace("[[minimise]]", moving))
    time = export_times(DURATION)

    def straight(rows):
        rows[:, 1:7], rows[:, 7:13] = time[:, None] * speed, speed
        rows[:, 13:19], rows[:, -6:] = 0.0, time[:, None] * speed
        return rows

    write_motion(folder, change=straight)
    seal(folder)
    assert run(["export", str(folder), "--to", to]) == 2
    assert "joint 1" in (said := capsys.readouterr().err)
    assert "starts with an approach to rest" in said
    assert run(["export", str(folder), "--to", "ros2"]) == 0


def fake_ros(published):
    """Modules of ROS 2 as far as the script needs them."""

    class Message:
        def __init__(self, **fields):
            self.points, self.__dict__ = [], {"points": [], **fields}

    node = types.SimpleNamespace(
        create_publisher=lambda kind, topic, depth: types.SimpleNamespace(
            get_subscription_count=lambda: 1, publish=lambda m: published.append((topic, m))
        ),
        destroy_node=lambda: None,
    )
    rclpy = types.ModuleType("rclpy")
    rclpy.init = rclpy.shutdown = lambda: None
    rclpy.create_node, rclpy.spin_once = lambda name: node, lambda node, timeout_sec: None
    modules = {"rclpy": rclpy}
    for package, names in (
        ("trajectory_msgs", ("JointTrajectory", "JointTrajectoryPoint")),
        ("builtin_interfaces", ("Duration",)),
    ):
        modules[package] = types.ModuleType(package)
        modules[f"{package}.msg"] = types.ModuleType(f"{package}.msg")
        for name in names:
            setattr(modules[f"{package}.msg"], name, Message)
    return modules


def test_script_publishes_only_its_own_file(folder, monkeypatch, capsys):
    pytest.importorskip("yaml")
    assert run(["export", str(folder), "--to", "ros2"]) == 0
    script = folder / "publish_trajectory.py"
    published = []
    for name, module in fake_ros(published).items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(sys, "argv", [str(script), "/arm/joint_trajectory"])
    scope = {"__name__": "script", "__file__": str(script)}
    exec(compile(script.read_text(), str(script), "exec"), scope)
    scope["main"]()
    ((topic, message),) = published
    assert topic == "/arm/joint_trajectory"
    assert len(message.points) == len(export_times(DURATION))
    np.testing.assert_allclose(message.points[-1].positions, FAR)
    assert vars(message.points[-1].time_from_start)["nanosec"] == round(DURATION * 1e9)
    with (folder / "joint_trajectory.yaml").open("a") as stream:
        stream.write("\n")
    with pytest.raises(SystemExit, match="is not the file that this script was exported with"):
        scope["main"]()
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert len(published) == 1
