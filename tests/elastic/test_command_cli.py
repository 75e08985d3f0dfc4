"""`stiffopt simulate` of a solve with a command: same or other uncertainty."""

from __future__ import annotations

import csv
import json
import shutil

import numpy as np
import pytest
from small_arms import write_problem

from stiffopt.cli import run


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Folder of a problem whose solve in `out` wrote a command.csv."""
    folder = tmp_path_factory.mktemp("led")
    extra = "[uncertainty]\ndraws = 50"
    path = write_problem(folder, minimise='objective = "tool_deviation"', extra=extra)
    assert run(["solve", str(path), "--out", str(folder / "out"), "--quiet"]) == 0
    assert (folder / "out" / "command.csv").is_file()
    return folder


def led(folder, *options, out):
    """Entry of the compensated optimised motion in simulation.json."""
    assert run(["simulate", str(folder / "out"), "--out", str(folder / out), *options]) == 0
    document = json.loads((folder / out / "simulation.json").read_text())["compensation"]
    assert document["command"] == "../out/command.csv"
    return document, document["motions"]["optimised"]["compensated"]


def test_simulated_command_repeats_the_values_of_the_solve(solved, capsys):
    document, anew = led(solved, out="same")
    assert document["servo"] is None
    inside = json.loads((solved / "out" / "result.json").read_text())["compensation"]
    before = inside["motions"]["optimised"]["compensated"]
    for phase in ("in_flight", "after_arrival"):
        for size in ("nominal", "worst"):
            assert anew[phase][size] == pytest.approx(before[phase][size], rel=0.02, abs=1e-7)
        assert len(anew[phase]["draws"]) == 50
    assert set(document["motions"]) == set(inside["motions"])
    told = capsys.readouterr().out
    assert f"With the command {solved / 'out' / 'command.csv'}" in " ".join(told.split())
    assert "as chosen by the solve" in " ".join(told.split())
    assert "best for the worst case" not in " ".join(told.split())
    page = (solved / "same" / "simulation.html").read_text()
    assert "Feedforward command ../out/command.csv" in page
    assert "With the command ../out/command.csv" in page
    assert document["motions"]["optimised"]["within_motor_limits"]
    assert "Diamond: nominal arm" in page


@pytest.mark.slow
def test_servo_option_applies_to_every_arm(solved, capsys):
    _, exact = led(solved, out="exact")
    options = ("--bandwidth", "20", "--feed-forward", "0.9")
    document, lagging = led(solved, *options, out="lagging")
    loop = "20 Hz with 90 % velocity and 90 % torque feed-forward, set-points at 250 Hz"
    assert document["servo"] == loop
    assert lagging["in_flight"]["nominal"] > 5 * exact["in_flight"]["nominal"]
    assert min(lagging["in_flight"]["draws"]) > 5 * exact["in_flight"]["nominal"]
    assert "position loops of 20 Hz with 90 %" in capsys.readouterr().out
    full = document["motions"]["optimised"]
    simulated = full["simulated"]["in_flight"]["peak"]
    assert simulated == pytest.approx(lagging["in_flight"]["nominal"], rel=0.02)


@pytest.mark.slow
def test_uncertainty_options_replace_those_of_the_solve(solved):
    _, wide = led(solved, out="wide")
    _, near = led(solved, "--set", "uncertainty.stiffness=0.05", out="near")
    assert near["in_flight"]["worst"] < 0.7 * wide["in_flight"]["worst"]
    # Made for 2 % of critical damping.
    _, damped = led(solved, "--damping", "0.2", out="damped")
    # The residual of the servo, which both have, is most of the first.
    assert damped["in_flight"]["nominal"] > 1.5 * wide["in_flight"]["nominal"]
    told = [
        json.loads((solved / out / "simulation.json").read_text())["assumed_damping"]
        for out in ("wide", "damped")
    ]
    assert told == [[1, 2], []]


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["--set", "motion.duration=0.7"], "changes of [uncertainty] only, such as"),
        (["--set", "uncertainty.stiffness=1.2"], "below 1"),
        (["--set", "uncertainty.stiff=0.1"], "stiff"),
        (["--damping", "2"], "damping is a share of the critical one"),
        (
            ["--bandwidth", "20", "--set", "uncertainty.servo_bandwidth=5"],
            "without uncertainty of servos",
        ),
        (
            ["--bandwidth", "20", "--set", "uncertainty = {servo_delay=0.001}"],
            "Omit one of the two",
        ),
    ],
)
def test_invalid_options_of_a_command_are_refused(solved, capsys, options, what):
    assert run(["simulate", str(solved / "out"), *options]) == 2
    assert what in capsys.readouterr().err


def test_baseline_commands_are_those_of_the_solve(solved):
    asked = ("--set", "uncertainty.stiffness=0.4", "--damping", "0.1")
    document, _ = led(solved, *asked, "--bandwidth", "15", "--feed-forward", "0.9", out="other")
    inside = json.loads((solved / "out" / "result.json").read_text())["compensation"]
    for name, before in inside["motions"].items():
        for key in ("knot_spacing", "share_of_windup"):
            assert document["motions"][name][key] == before[key]
        assert document["motions"][name]["within_motor_limits"] == before["within_motor_limits"]


def test_command_beyond_motor_limits_is_reported(solved, tmp_path, capsys):
    shutil.copytree(solved, tmp_path / "copy")
    out = tmp_path / "copy" / "out"
    (out / "manifest.json").unlink()
    with (out / "command.csv").open() as stream:
        head, *rows = csv.reader(stream)
    table = np.array(rows, dtype=float)
    at, rate = table[:, 0], 20.0 * np.pi / table[-1, 0]
    wave = (1.0 - np.cos(rate * at), rate * np.sin(rate * at), rate**2 * np.cos(rate * at))
    for quantity, values in zip(("q1", "qd1", "qdd1"), wave, strict=True):
        table[:, head.index(quantity)] += 0.03 * values
    with (out / "command.csv").open("w") as stream:
        csv.writer(stream, lineterminator="\n").writerows([head, *table.tolist()])
    assert run(["simulate", str(out)]) == 0
    assert "exceeds" in capsys.readouterr().out
    document = json.loads((out / "simulation.json").read_text())["compensation"]
    assert document["command"] == "command.csv"
    own = document["motions"]["optimised"]
    assert not own["within_motor_limits"]
    assert {"acceleration"} <= {each["limit"] for each in own["excess"]}


def test_changed_or_missing_command_is_refused(solved, tmp_path, capsys):
    shutil.copytree(solved, tmp_path / "copy")
    out = tmp_path / "copy" / "out"
    with (out / "command.csv").open("a") as stream:
        stream.write("9,9,9\n")
    assert run(["simulate", str(out)]) == 2
    assert "was changed since" in capsys.readouterr().err
    (out / "command.csv").unlink()
    assert run(["simulate", str(out)]) == 2
    assert "command.csv" in capsys.readouterr().err
    document = json.loads((out / "result.json").read_text())
    (out / "manifest.json").unlink()
    (out / "result.json").write_text(json.dumps({**document, "compensation": None}))
    assert run(["simulate", str(out), "--set", "uncertainty.stiffness=0.1"]) == 2
    assert "uncertainties apply to a command" in capsys.readouterr().err
