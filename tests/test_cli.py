"""The commands as people run them: files, exit codes, and what they print."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from small_arms import ROOT, write_problem, write_robot
from synthetic_solution import trajectory_columns

from stiffopt.cli import app, run
from stiffopt.cli.base import default_folder

PEAK = 'objective = "dynamic_deflection"'

# The quintic motion with lead does better on this plain job: it is handed over.
RESULT = [
    "formulas.npz",
    "manifest.json",
    "report.html",
    "result.json",
    "rival_command.csv",
    "rival_trajectory.csv",
    "state.bin",
    "trajectory.csv",
]


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Exit code and folder of one solve."""
    folder = tmp_path_factory.mktemp("solve")
    path = write_problem(folder, minimise=PEAK)
    code = run(["solve", str(path), "--out", str(folder / "out"), "--quiet"])
    return code, folder / "out"


def test_solve_writes_its_files_and_no_more(solved):
    code, out = solved
    assert code == 0
    assert sorted(p.name for p in out.iterdir()) == RESULT


def test_result_file(solved):
    result = json.loads((solved[1] / "result.json").read_text())
    assert result["schema"] == 1
    assert result["status"] == "optimal"
    assert result["message"].endswith(".")
    assert set(result["objective"]) >= {"name", "measure", "value", "unit"}
    assert (result["objective"]["name"], result["objective"]["unit"]) == ("dynamic_deflection", "m")
    assert result["duration"] == pytest.approx(0.5)
    certificate = result["certificate"]
    assert certificate["points"] >= 6001
    assert set(certificate["worst_violation"]) == {"value", "limit", "joint", "time"}
    assert certificate["worst_violation"]["value"] <= 5e-3
    assert set(certificate["min_stiffness"]) == {"value", "joint", "time"}
    for part in ("dynamic", "static", "process", "total"):
        assert set(certificate["deflection"][part]) == {"peak", "rms"}
    peak = certificate["deflection"]["dynamic"]["peak"]
    assert result["objective"]["value"] == pytest.approx(peak, rel=1e-12)
    for name in ("toppra", "quintic"):
        assert set(result["baselines"][name]) >= {
            "feasible",
            "duration",
            "deflection",
            "min_stiffness",
        }
    best = min(b["objective"] for b in result["baselines"].values() if b["feasible"])
    assert result["ratio_to_better_baseline"] == pytest.approx(peak / best)
    assert result["ratio_to_better_baseline"] < 1
    solver = result["solver"]
    assert set(solver) >= {"iterations", "build_s", "solve_s", "homotopy", "transcription"}
    assert solver["transcription"] == "piecewise_linear_acceleration"
    assert len(result["inputs_hash"]) == 64
    assert {"stiffopt", "casadi", "pin", "numpy"} <= set(result["versions"])


def test_trajectory_file(solved):
    with (solved[1] / "trajectory.csv").open() as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == trajectory_columns(2)
    table = np.array(rows[1:], dtype=float)
    t = table[:, 0]
    assert len(t) == 251
    assert np.diff(t) == pytest.approx(0.002)
    column = {name: table[:, k] for k, name in enumerate(rows[0])}
    for joint, (first, last) in ((1, (-0.6, 0.5)), (2, (0.4, 0.2))):
        assert column[f"q{joint}"][[0, -1]] == pytest.approx([first, last], abs=1e-6)
        # The columns are one motion: the velocity is the position's slope.
        slope = np.gradient(column[f"q{joint}"], t)[2:-2]
        assert column[f"qd{joint}"][2:-2] == pytest.approx(slope, abs=5e-3)
        assert np.all(column[f"k{joint}"] > 0)
    total = np.sqrt(sum(column[f"deflection_dynamic_{axis}"] ** 2 for axis in "xyz"))
    result = json.loads((solved[1] / "result.json").read_text())
    assert np.max(total) == pytest.approx(result["objective"]["value"], rel=1e-2)


def test_report_is_self_contained(solved):
    page = (solved[1] / "report.html").read_text()
    assert page.count("<svg") >= 4
    assert 'src="http' not in page
    assert 'href="http' not in page.split("</head>")[0]


def test_solve_prints_what_matters(tmp_path, capsys):
    path = write_problem(tmp_path, "swivel", minimise=PEAK)
    out = tmp_path / "out"
    assert run(["solve", str(path), "--out", str(out)]) == 0
    streams = capsys.readouterr()
    assert streams.out.startswith("optimal: ")
    assert "mm" in streams.out
    assert str(out / "report.html") in streams.out
    # Progress goes to the other stream: stage, iteration, objective, worst row, time.
    assert "iteration" in streams.err
    assert "violation" in streams.err


def test_no_usable_motion(tmp_path, capsys):
    path = write_problem(
        tmp_path,
        duration="0.32",
        limits="torque = [14.0, 60.0]",
        method="intervals = 16\ntime_limit = 20",
    )
    out = tmp_path / "out"
    assert run(["solve", str(path), "--out", str(out), "--quiet"]) == 3
    result = json.loads((out / "result.json").read_text())
    assert result["status"] == "infeasible"
    assert "longer duration" in result["message"]
    assert result["ratio_to_better_baseline"] is None
    assert (out / "report.html").exists()
    assert capsys.readouterr().out.startswith("infeasible: ")


EXPECTED = """[expected]
objective = {value}
unit = "{unit}"
rtol = 1e-3
source = "exact: 12 d^2 / T^3"
"""
EXACT = {
    "robot": "swivel",
    "duration": "0.8",
    "minimise": 'objective = "acceleration_squared"',
    "motion": 'boundary_acceleration = "free"',
}


def verify(folder, capsys, value, unit="rad^2/s^3"):
    write_problem(folder, limits=EXPECTED.format(value=value, unit=unit), **EXACT)
    code = run(["verify", str(folder), "--quiet"])
    return code, capsys.readouterr().out


def test_verify(tmp_path, capsys):
    right = 12.0 / 0.8**3
    code, text = verify(tmp_path, capsys, right)
    assert code == 0
    assert "problem" in text
    assert "ok" in text
    code, text = verify(tmp_path, capsys, right * 1.01)
    assert code == 1
    assert "OFF" in text
    code, text = verify(tmp_path, capsys, right * np.degrees(1) ** 2, "deg^2/s^3")
    assert code == 0


def test_verify_takes_several_paths_and_each_file_once(tmp_path, capsys):
    right, wrong = tmp_path / "right", tmp_path / "wrong"
    for folder, value in ((right, 12.0 / 0.8**3), (wrong, 1.0)):
        folder.mkdir()
        verify(folder, capsys, value)
    code = run(["verify", str(right / "problem.toml"), str(right), str(wrong), "--quiet"])
    text = capsys.readouterr().out
    assert code == 1
    assert (text.count(" ok "), text.count("OFF")) == (1, 1)


def test_without_out_a_changed_file_leaves_the_answer_of_the_unchanged(
    tmp_path, monkeypatch, capsys
):
    path = write_problem(tmp_path, **EXACT)
    monkeypatch.chdir(tmp_path)
    solve = ["solve", str(path), "--quiet"]
    assert run(solve) == 0
    before = {p.name: p.read_bytes() for p in (tmp_path / "out" / "problem").iterdir()}
    assert "trajectory.csv" in before
    capsys.readouterr()
    assert run([*solve, "--set", "motion.duration='10 ms'"]) == 3
    assert "out/problem-motion.duration=10_ms/report.html" in capsys.readouterr().out
    assert {p.name: p.read_bytes() for p in (tmp_path / "out" / "problem").iterdir()} == before


def test_folders_of_changes_have_names_that_can_be_typed():
    assert default_folder("arm", ()) == Path("out/arm")
    changed = default_folder("arm", ("payload.mass=-3", "joint[1].source=a/../b c"))
    assert changed == Path("out/arm-payload.mass=-3-joint_1_.source=a_.._b_c")
    long = [default_folder("arm", (f"title={300 * 'a'}{end}",)) for end in "xy"]
    assert long[0] != long[1]
    assert all(len(folder.name) < 128 for folder in long)


def test_verify_of_a_file_without_an_expected_value(tmp_path, capsys):
    path = write_problem(tmp_path, **EXACT)
    assert run(["verify", str(path), "--quiet"]) == 1
    assert "[expected]" in capsys.readouterr().out


def test_stiffness(tmp_path, capsys):
    robot = write_robot(tmp_path)
    out = tmp_path / "out"
    assert run(["stiffness", str(robot), "--out", str(out)]) == 0
    with (out / "stiffness.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["joint"] for row in rows} == {"1", "2"}
    assert (out / "stiffness.csv").as_posix() in capsys.readouterr().out
    assert [p.suffix for p in sorted(out.glob("*.html"))] == [".html"]


@pytest.mark.parametrize("kind", ["trajectory", "robot"])
def test_schema(kind, capsys):
    assert run(["schema", kind]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {"schema", "kind", "robot" if kind == "trajectory" else "joint"} <= set(
        document["properties"]
    )


def test_help_and_version(capsys):
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    for command in ("solve", "verify", "stiffness", "schema"):
        assert command in text
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == "0.2.0"


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupt_keeps_the_best_motion(tmp_path):
    path = write_problem(
        tmp_path, "spatial", minimise=PEAK, method="intervals = 300\nmax_iterations = 2000"
    )
    out = tmp_path / "out"
    command = [sys.executable, "-m", "stiffopt", "solve", str(path), "--out", str(out)]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        line = process.stderr.readline()
        assert "iteration" in line
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    result = json.loads((out / "result.json").read_text())
    assert result["status"] == "interrupted"
    assert "Stopped by the user" in result["message"]
    assert output.startswith("interrupted: ")
    with (out / "trajectory.csv").open() as stream:
        rows = list(csv.reader(stream))
    assert {len(row) for row in rows} == {len(trajectory_columns(3))}
    assert (out / "report.html").read_text().rstrip().endswith("</html>")
    # Simulations, and with them rivals, are left out; a motion that is no optimum has no state.
    assert sorted(p.name for p in out.iterdir()) == [
        n for n in RESULT if "rival" not in n and n not in ("formulas.npz", "state.bin")
    ]


def test_entries_can_be_changed_on_every_command_that_reads_a_file(tmp_path, capsys):
    """Beside solve, preload and diagnose."""
    shipped = ROOT / "problems" / "recordings" / "two_link_friction"
    assert run(["recording", "check", str(shipped), "--set", "runs[1].role='test'"]) == 0
    assert "train_1.npz (test)" in capsys.readouterr().out
    robot = str(ROOT / "problems" / "two_link_robot.toml")
    assert run(["modes", robot, "--at", "0.1 0.2", "--set", "joint[1].damping=3.0"]) == 0
    assert "damping of joint 2 is assumed" in capsys.readouterr().out
    change = "joint[1].torque_max=1000.0"
    assert run(["stiffness", robot, "--out", str(tmp_path / "s"), "--set", change]) == 0
    capsys.readouterr()
    assert run(["modes", str(shipped / "robot.urdf"), "--at", "0 0", "--set", "a=1"]) == 2
    assert "a URDF has no entries" in capsys.readouterr().err
    (tmp_path / "static.toml").write_text('schema = 1\nkind = "static"\n')
    assert run(["identify-stiffness", str(tmp_path), "--set", "nonsense"]) == 2
    assert "needs KEY=VALUE" in capsys.readouterr().err


WRITE = [
    *("solve", "preload", "stiffness", "diagnose", "identify-stiffness", "export", "simulate"),
    *("budget", "modes", "sweep", "init robot", "init problem", "init recording", "init flange"),
]
HAVE_A_PAGE = [
    *("solve", "preload", "stiffness", "diagnose", "identify-stiffness", "simulate", "sweep"),
    "budget",
]


@pytest.mark.parametrize("command", WRITE)
def test_every_command_that_writes_has_the_short_form_of_out(command, capsys):
    assert run([*command.split(), "--help"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"--out -o", said)
    assert ("--open" in said) == (command in HAVE_A_PAGE)


def test_the_short_form_of_out_is_the_long_one(tmp_path, capsys):
    robot = str(ROOT / "problems" / "two_link_robot.toml")
    assert run(["stiffness", robot, "-o", str(tmp_path / "s")]) == 0
    assert run(["init", "problem", robot, "-o", str(tmp_path / "first.toml")]) == 0
    assert (tmp_path / "s" / "stiffness.csv").is_file()
    assert (tmp_path / "first.toml").is_file()
    assert run(["init", "problem", robot, "-o", str(tmp_path / "x.toml"), "--set", "a=1"]) == 2
    assert "use --set with the command that reads it" in capsys.readouterr().err


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_of_shells_knows_commands_and_options(shell):
    text = app.generate_completion(shell=shell)
    for word in ("identify-stiffness", "recording", "open", "set", "quiet"):
        assert word in text
