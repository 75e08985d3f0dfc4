"""`stiffopt diagnose` and `recording check`: sets and runs that are wrong, and Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from diagnosed_folders import columns_of, contents, copied, written
from simulated_sets import COULOMB, diagnosed

from stiffopt.cli import run
from tests.identification.static_arms import THREE, BentArm, measure


def edited(source, before, after, count=-1):
    """Change recordings.toml."""
    path = source / "recordings.toml"
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after, count))


def without_torque(source):
    path = source / "recordings.toml"
    lines = path.read_text().splitlines()
    kept = [each for each in lines if not each.startswith('torque = ["')]
    assert len(kept) == len(lines) - 1
    path.write_text("\n".join(kept))


def other_columns(source):
    columns = columns_of(source / "train_1.npz")
    np.savez(source / "train_1.npz", **{f"x_{name}": v for name, v in columns.items()})


def backwards(source):
    columns = columns_of(source / "train_1.npz")
    np.savez(source / "train_1.npz", **columns | {"t": columns["t"][::-1].copy()})


def other_joints(source):
    edited(source, '["joint1", "joint2"]', '["joint1", "elbow"]')


def two_runs_no_test(source):
    path = source / "recordings.toml"
    head, *runs = path.read_text().split("[[runs]]\n")
    path.write_text("[[runs]]\n".join([head, *runs[:2]]))


WRONG = {
    "no torque": (without_torque, ["recordings.toml", "signals.torque"]),
    "other columns": (other_columns, ["train_1.npz", "x_"]),
    "times running backwards": (backwards, ["train_1.npz", "t", "back"]),
    "joints that the robot lacks": (other_joints, ["elbow", "joint2"]),
    "no test run": (two_runs_no_test, ["none of the 2 runs", '"test"']),
}


@pytest.mark.parametrize("command", ["diagnose", "check"])
@pytest.mark.parametrize("name", WRONG)
def test_invalid_input_gives_one_message(tmp_path, capsys, name, command):
    change, words = WRONG[name]
    source = copied(COULOMB, tmp_path / "set")
    change(source)
    before, out = contents(source), tmp_path / "out"
    arguments = {
        "diagnose": ["diagnose", str(source), "--out", str(out), "--quiet"],
        "check": ["recording", "check", str(source)],
    }[command]
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert error.count("stiffopt: ") == 1
    assert "Traceback" not in error
    for word in words:
        assert word in error, error
    assert not out.exists()
    assert contents(source) == before


def test_results_are_not_written_into_the_set(tmp_path, capsys):
    source = copied(COULOMB, tmp_path / "set")
    assert run(["diagnose", str(source), "--out", str(source / "out")]) == 2
    assert "read-only" in capsys.readouterr().err
    assert not (source / "out").exists()


def test_interrupt_while_writing_leaves_whole_files(tmp_path, monkeypatch, capsys):
    """Half of the files are there when the interruption comes; earlier results stay whole."""
    import stiffopt.discovery.diagnose
    from stiffopt.discovery import store as answer_store

    plain, calls = answer_store.atomic_write, []

    def interrupted(path, content):
        calls.append(path)
        if len(calls) == 4:
            raise KeyboardInterrupt
        plain(path, content)

    found = diagnosed(COULOMB)
    monkeypatch.setattr(stiffopt.discovery.diagnose, "diagnose", lambda *_, **__: found)
    arguments = ["diagnose", str(written(COULOMB)), "--quiet", "--out"]
    earlier, out = tmp_path / "earlier", tmp_path / "out"
    assert run([*arguments, str(earlier)]) == 0
    before = contents(earlier)
    assert {"diagnosis.json", "extended.toml", "report.html"} <= set(before)
    monkeypatch.setattr(answer_store, "atomic_write", interrupted)
    for folder in (out, earlier):
        calls.clear()
        assert run([*arguments, str(folder)]) == 130
        assert "interrupted; nothing was written" in capsys.readouterr().err
        assert len(calls) == 4
    assert not out.exists()
    assert contents(earlier) == before


@pytest.mark.slow
def test_ctrl_c_exits_130_without_files(tmp_path):
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "stiffopt", "diagnose", str(written(COULOMB)), "--out", str(out)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
        # Jobs in the background of a shell ignore the signal, and pass that on.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    line = ""
    while "compare with the nominal model" not in line:
        line = process.stderr.readline()
        assert line, "ended before it was interrupted"
    assert out.is_dir()
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted; nothing was written" in errors
    assert "Traceback" not in errors
    assert not out.exists()


def test_check_lists_channels_and_identifiable_effects(capsys):
    source = written(COULOMB)
    before = contents(source)
    assert run(["recording", "check", str(source)]) == 0
    text = capsys.readouterr().out
    assert "2 joints, 5 runs" in text
    assert "train_1.npz (train): 1250 samples" in text
    assert "joint 1 (joint1): motor, link, deflection" in text
    assert "  coulomb: joints 1, 2" in text
    assert run(["recording", "check", str(source), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [each["role"] for each in document["runs"]].count("train") == 3
    coulomb = [each for each in document["effects"] if each["effect"] == "coulomb"]
    assert [each["possible"] for each in coulomb] == [True, True]
    assert contents(source) == before


def test_check_lists_faults_and_missing_data(tmp_path, capsys):
    source = copied(COULOMB, tmp_path / "set")
    columns = columns_of(source / "train_2.npz")
    columns["tau1"][:] = 3.0
    np.savez(source / "train_2.npz", **columns)
    edited(source, "pole_pairs", "# pole_pairs")
    assert run(["recording", "check", str(source)]) == 0
    text = capsys.readouterr().out
    fault = next(line for line in text.splitlines() if line.startswith("  ! "))
    assert "torque of joint 1" in fault
    assert "tau1 (torque of joint 1): left out" in text
    ripple = next(line for line in text.splitlines() if line.startswith("  torque_ripple"))
    assert "no joint" in ripple


def test_check_without_usable_test_run(tmp_path, capsys):
    source = copied(COULOMB, tmp_path / "set")
    file = next(source.glob("test_*.npz"))
    columns = columns_of(file)
    columns["q1"][:] = np.nan
    np.savez(file, **columns)
    assert run(["recording", "check", str(source)]) == 2
    streams = capsys.readouterr()
    assert "cannot be used" in streams.out
    assert 'no run of the role "test" can be used' in streams.err


def test_check_of_a_static_set(tmp_path, capsys):
    source = measure(THREE, 9, 1).write(tmp_path / "set")
    assert run(["recording", "check", str(source)]) == 0
    text = capsys.readouterr().out
    assert "static set, 3 joints, 9 poses" in text
    assert text.count("): yes, load") == 3
    assert "No nominal stiffness" in text
    on_axis = BentArm(tool=(0.3, 0.0, 0.0))
    source = measure(on_axis, 9, 2).write(tmp_path / "axis")
    assert run(["recording", "check", str(source), "--json"]) == 0
    joints = json.loads(capsys.readouterr().out)["joints"]
    assert [each["identifiable"] for each in joints] == [True] * 5 + [False]


@pytest.mark.parametrize("kind", ["recordings", "static", "extended"])
def test_schemas_of_files_about_recordings(kind, capsys):
    assert run(["schema", kind]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {"schema", "name", "joints"} <= set(document["properties"])
