"""Command lines `stiffopt simulate` and `stiffopt modes`."""

from __future__ import annotations

import csv
import json
import shutil

import numpy as np
import pytest
from small_arms import joint, write_problem, write_robot

from stiffopt.cli import run
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.report.common.text import significant
from stiffopt.robot.files import load_robot
from stiffopt.starter.problem_file import first_motion


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Folder of a problem with its solve in `out`."""
    folder = tmp_path_factory.mktemp("swing")
    path = write_problem(folder, minimise='objective = "dynamic_deflection"')
    assert run(["solve", str(path), "--out", str(folder / "out"), "--quiet"]) == 0
    return folder


@pytest.fixture
def copied(solved, tmp_path):
    """Copy of the folder that a test may change."""
    shutil.copytree(solved, tmp_path / "copy")
    return tmp_path / "copy"


def test_simulate_repeats_the_values_of_the_solve(solved, capsys):
    out = solved / "simulated"
    assert run(["simulate", str(solved / "out"), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "optimised" in printed
    assert "2 % of critical" in printed
    inside = json.loads((solved / "out" / "result.json").read_text())
    assert inside["problem"] == "../problem.toml"
    anew = json.loads((out / "simulation.json").read_text())
    assert anew["schema"] == 1
    for name, motion in inside["simulation"]["motions"].items():
        other = anew["motions"][name]
        assert other["planned"]["peak"] == pytest.approx(motion["planned"]["peak"], rel=1e-6)
        assert other["in_flight"]["peak"] == pytest.approx(motion["in_flight"]["peak"], rel=2e-3)
    with (out / "simulation.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    peak = max(np.linalg.norm([float(row[f"deviation_{axis}"]) for axis in "xyz"]) for row in rows
               if float(row["t"]) <= 0.5)  # fmt: skip
    assert peak == pytest.approx(anew["motions"]["optimised"]["in_flight"]["peak"], rel=1e-3)
    page = (out / "simulation.html").read_text()
    assert "Peak vibration of the tool" in page
    assert 'id="scene-document"' in page
    assert len(page) < 3e6


def test_report_shows_vibration_beside_the_certificate(solved):
    page = (solved / "out" / "report.html").read_text()
    assert "Elastic simulation" in page
    assert "after arrival" in page
    # The servo of the problem, by default an industrial one.
    assert "The motors follow each motion in position loops of 20 Hz" in page


def test_jerky_plan_without_feasible_command_gives_the_reason(solved, capsys):
    out = solved / "out"
    assert not (out / "command.csv").exists()
    document = json.loads((out / "result.json").read_text())["compensation"]
    assert document["command"] is None
    assert "the motors would exceed" in document["refusal"]
    assert set(document["motions"]) >= {"optimised", "toppra", "quintic"}
    page = (out / "report.html").read_text()
    assert "Feedforward compensation on uncertain arms" in page
    assert "the motors would exceed" in page


def test_servo_lag_increases_the_deviation(solved, capsys):
    exact, late = ["--bandwidth", "20", "--band", "1 mm"], ["--feed-forward", "0.5"]
    found = []
    for name, options in (("plain", exact), ("lagging", [*exact, *late, "--delay", "1 ms"])):
        out = solved / name
        assert run(["simulate", str(solved / "out"), "--out", str(out), *options]) == 0
        found.append(json.loads((out / "simulation.json").read_text())["motions"]["optimised"])
    plain, lagging = found
    assert lagging["in_flight"]["peak"] > 5 * plain["in_flight"]["peak"]
    assert lagging["settling_band"] == 1e-3


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["--bandwidth", "20", "--delay", "20 ms"], "the servo is unstable"),
        (["--feed-forward", "1.5"], "a share from 0 to 1, got 1.5"),
        (["--band", "1 kg"], "band"),
        (["--band", "0 mm"], "--band 0 mm: must be above 0"),
        (["--bandwidth", "-3"], "bandwidth must be above 0"),
    ],
)
def test_invalid_options_are_refused(solved, capsys, options, what):
    assert run(["simulate", str(solved / "out"), *options]) == 2
    assert what in capsys.readouterr().err


def test_results_that_cannot_be_simulated_give_the_reason(copied, capsys):
    out = copied / "out"
    document = json.loads((out / "result.json").read_text())

    def refused(what, *options):
        assert run(["simulate", str(out), *options]) == 2
        assert what in capsys.readouterr().err

    (copied / "problem.toml").rename(copied / "moved.toml")
    refused("there is no problem file")
    assert run(["simulate", str(out), "--problem", str(copied / "moved.toml")]) == 0
    text = (copied / "moved.toml").read_text()
    (copied / "problem.toml").write_text(text.replace("duration = 0.5", "duration = 0.6"))
    refused("differs from the problem solved")
    named = document.pop("problem")
    (out / "result.json").write_text(json.dumps(document))
    refused("was changed since `stiffopt solve` wrote it")
    (out / "manifest.json").unlink()
    refused("does not say which problem file")
    (copied / "problem.toml").write_text(text)
    (out / "result.json").write_text(
        json.dumps({**document, "problem": named, "certificate": None})
    )
    refused("found no motion")
    for part in ({"value": "\x85"}, {"value": []}, [], None):
        certificate = {**document["certificate"], "worst_violation": part}
        whole = {**document, "problem": named, "certificate": certificate}
        (out / "result.json").write_text(json.dumps(whole))
        refused("has no usable numbers")
    (out / "result.json").write_text("{")
    refused("is no JSON text")
    (out / "result.json").unlink()
    refused("result.json")


def test_damping_above_critical_is_refused_before_the_solve(tmp_path, capsys):
    path = write_problem(tmp_path)
    arm = tmp_path / "planar.toml"
    arm.write_text(arm.read_text().replace('name = "elbow"', 'name = "elbow"\ndamping = 500.0'))
    assert run(["solve", str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "the damping of elbow must lie between 0 and the critical" in said
    assert not (tmp_path / "out").exists()


def test_modes_default_to_the_start_of_the_first_problem(solved, capsys):
    path = solved / "planar.toml"
    robot = load_robot(path)
    start = first_motion(robot).start
    expected = modes(ElasticArm(robot, start), start)[0].frequency
    assert run(["modes", str(path)]) == 0
    assert f"{significant(expected, 4)} Hz" in capsys.readouterr().out


def test_modes_of_a_robot_a_problem_and_a_motion(solved, capsys):
    assert run(["modes", str(solved / "planar.toml"), "--at", "0.2 -20deg"]) == 0
    assert "joint 1 (" in capsys.readouterr().out
    assert run(["modes", str(solved / "problem.toml")]) == 0
    printed = capsys.readouterr().out
    assert "start" in printed
    assert "end" in printed
    assert run(["modes", str(solved / "out"), "--out", str(solved / "modes")]) == 0
    with (solved / "modes" / "modes.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 61
    assert float(rows[0]["f1"]) < float(rows[0]["f2"])
    assert (solved / "modes" / "modes.svg").read_text().startswith("<svg")


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["planar.toml", "--at", "0.1"], "--at needs 2 values"),
        (["planar.toml", "--at", "0.1, 20mm"], "--at, elbow"),
        (["planar.toml", "--at", "20 20deg"], "joint 1 at 20 rad (1146 deg) is outside its range"),
        (["nowhere"], "no robot"),
        (["out", "--at", "0 0"], "Omit --at"),
    ],
)
def test_invalid_poses_are_refused(solved, capsys, arguments, what):
    path = solved / arguments[0]
    source = str(path) if path.exists() else arguments[0]
    assert run(["modes", source, *arguments[1:]]) == 2
    assert what in capsys.readouterr().err


def test_modes_of_a_rigid_arm_are_refused(tmp_path, capsys):
    rigid = write_robot(tmp_path, joints=[joint("shoulder", ""), joint("elbow", "")])
    assert run(["modes", str(rigid), "--at", "0 0"]) == 2
    assert "is rigid: no joint has an elastic drivetrain" in capsys.readouterr().err


def test_number_without_unit_is_si_on_the_command_line(solved, capsys):
    found = []
    for number, name in (("1e-4", "bare"), ("0.1 mm", "unit")):
        out = solved / name
        assert run(["simulate", str(solved / "out"), "--out", str(out), "--band", number]) == 0
        found.append((out / "simulation.json").read_text())
    assert found[0] == found[1]
    capsys.readouterr()
    assert run(["simulate", str(solved / "out"), "--band", "1 kg"]) == 2
    assert "--band" in capsys.readouterr().err
