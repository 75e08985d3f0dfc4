"""Wrong inputs of people who begin: one sentence that says what and where, and exit code 2."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.report.common.text import change, percent
from stiffopt.result.assessment import Violation

SHIPPED = ROOT / "problems" / "recordings" / "two_link_friction"
URDF = SHIPPED / "robot.urdf"
PROBLEM = f"""schema = 1
kind = "trajectory"
robot = "{(ROOT / "problems" / "two_link_robot.toml").as_posix()}"
[motion]
start = {{ joints = ["0 deg", "10 deg"] }}
end = {{ joints = ["40 deg", "50 deg"] }}
duration = "1 s"
[[minimise]]
objective = "torque_squared"
"""


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What is said of wrong arguments, on one line and without a traceback."""
    capsys.readouterr()
    assert run([str(each) for each in arguments]) == 2
    said = capsys.readouterr().err
    assert said.startswith("stiffopt: ")
    assert "Traceback" not in said
    assert "Warning" not in said
    return said


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('"0 deg", "10', '"0 mm", "10', "joint_1: the joint is revolute and needs angle"),
        ('"1 s"', '"1 kg"', "the unit 'kg' is not one of time"),
        ('"1 s"', '"-1 s"', "allowed is a finite number above 0"),
        ('"0 deg", "10', '"10', "needs 2 values, one a joint (joint_1, joint_2); got 1"),
        ('"0 deg", "10', '0.0, 0.1, "10', "needs 2 values, one a joint"),
        ('"0 deg", "10', 'nan, "10', "angle must be a finite number"),
    ],
)
def test_numbers_of_a_motion(old, new, what, tmp_path, capsys):
    path = tmp_path / "p.toml"
    path.write_text(PROBLEM.replace(old, new))
    assert what in told(capsys, "solve", path, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_places_that_are_no_files(tmp_path, capsys):
    problem = tmp_path / "p.toml"
    problem.write_text(PROBLEM)
    (tmp_path / "one.toml").symlink_to("two.toml")
    (tmp_path / "two.toml").symlink_to("one.toml")
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "latin.toml").write_bytes(b'title = "Schwei\xdf"\n')
    os.mkfifo(tmp_path / "pipe.toml")
    for name, what in (
        ("one.toml", "is a link to two.toml, where no file is found"),
        ("folder.toml", "is a folder. Give the file inside it"),
        ("latin.toml", "is not UTF-8 text"),
        ("pipe.toml", "is a device or a pipe"),
    ):
        assert what in told(capsys, "solve", tmp_path / name)
    assert "Not a directory" in told(capsys, "solve", problem, "-o", problem)
    assert "symbolic links" in told(capsys, "solve", problem, "-o", tmp_path / "one.toml")
    assert problem.read_text() == PROBLEM


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("mass value=", 'mass value="-3" was=', "the mass -3 is below 0"),
        ("lower=", 'lower="9" was=', "needs limits with lower below upper"),
        ("effort=", 'effort="-5" was=', "limit effort = -5 is below 0"),
        ("axis xyz=", 'axis xyz="0 0 0" was=', "has the axis 0 0 0. Give its direction"),
        ("izz=", 'izz="-1" was=', "izz = -1 is below 0"),
    ],
)
def test_numbers_of_a_urdf(old, new, what, tmp_path, capsys):
    text = URDF.read_text()
    assert old in text
    (tmp_path / "arm.urdf").write_text(text.replace(old, new))
    assert what in told(capsys, "init", "robot", tmp_path / "arm.urdf")
    assert not (tmp_path / "arm_robot.toml").exists()


def test_tips_that_are_none(tmp_path, capsys):
    out = tmp_path / "r.toml"
    for tip, what in (
        ("joint1", "Did you mean 'link1'?"),
        ("base", "the link 'base' does not move"),
    ):
        assert what in told(capsys, "init", "robot", URDF, "--tip", tip, "-o", out)
    assert "exists and is kept" in told(capsys, "init", "robot", URDF, "-o", URDF)


def spoiled(folder: Path, name: str, columns: object) -> Path:
    """The shipped set with some columns of its runs changed."""
    copy = folder / name
    shutil.copytree(SHIPPED, copy)
    for file in copy.glob("*.npz"):
        with np.load(file) as stored:
            found = dict(stored)
        columns(found)
        np.savez(file, **found)
    return copy


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda c: c.update({k: v[:1] for k, v in c.items()}), "has 1 time stamps; a run needs 20"),
        (lambda c: c.update(t=c["t"][::-1].copy()), "time runs backwards 799 times"),
        (lambda c: c.update(t=0.0 * c["t"]), "holds only 1 different times in 800 rows"),
        (lambda c: c.update(q1=np.full(800, np.inf)), "has no position that can be trusted"),
        (lambda c: c.update(q1=c["q1"].astype(complex)), "needs a list of numbers"),
        (lambda c: c.update(q1=c["q1"][:-7]), "the columns have unequal lengths"),
        (lambda c: c.update(q1=c["q2"], q2=c["q1"]), "look exchanged"),
    ],
)
def test_columns_of_a_run(change, what, tmp_path, capsys):
    assert what in told(capsys, "recording", "check", spoiled(tmp_path, "set", change))


def rows(row: Callable[[int], str]) -> str:
    return "\n".join(["t,q1,q2,tau1,tau2", *(row(k) for k in range(900))])


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "holds no numbers"),
        ("t,q1,q2,tau1,tau2\n", "holds no row of numbers"),
        ("t,q1,q2,tau1,tau2\n0,1,2,3,4", "t, a time by its name, does not"),
        (
            rows(lambda k: f"{9 - 0.01 * k},{0.001 * k},{0.002 * k},{k % 9},2"),
            "t, a time by its name, does not",
        ),
        (
            rows(lambda k: f"5,{0.001 * k},{0.002 * k},{k % 9},2"),
            "t, a time by its name, does not",
        ),
        (rows(lambda _: "a,b,c,d,e"), "holds no row of numbers"),
    ],
)
def test_tables(text, what, tmp_path, capsys):
    table = tmp_path / "log.csv"
    table.write_text(text)
    out = tmp_path / "set"
    assert what in told(capsys, "init", "recording", table, "--urdf", URDF, "-o", out)
    assert not out.exists()


def test_a_table_is_no_urdf_and_a_file_no_folder(tmp_path, capsys):
    table = tmp_path / "log.csv"
    table.write_text("t,q1\n0,1\n")
    said = told(capsys, "init", "recording", table, "--urdf", table)
    assert "is a recording, not a URDF" in said
    assert "is a file. Give a folder as --out" in told(capsys, "init", "flange", "-o", table)
    options = ["--count", 2, "--tilting-moment", "5 N*m"]
    said = told(capsys, "init", "flange", "-o", tmp_path / "f", *options)
    assert "2 bolts carry no tilting moment about every axis" in said


def test_a_folder_without_a_name_is_not_the_current_one(tmp_path, capsys, monkeypatch):
    (tmp_path / "p.toml").write_text(PROBLEM)
    monkeypatch.chdir(tmp_path)
    for arguments in (
        ("solve", "p.toml", "--out", ""),
        ("solve", "p.toml", "--out="),
        ("init", "robot", URDF, "-o", " "),
        ("init", "flange", "--out", ""),
    ):
        assert "got no name" in told(capsys, *arguments)
    assert [each.name for each in tmp_path.iterdir()] == ["p.toml"]


def test_what_is_exceeded_many_times_is_told_as_a_factor():
    said = [Violation(v, "jerk", 2, 0.5).describe() for v in (79926.2761, 9.99)]
    assert said == [
        "jerk of joint 2 at 0.500 s by 80,000 times",
        "jerk of joint 2 at 0.500 s by 999.00%",
    ]
    assert (percent(12.0), change(11.0)) == ("12 times", "11 times as much")


def test_value_in_place_of_a_section_is_told_with_what_to_write(tmp_path, capsys):
    file = tmp_path / "p.toml"
    file.write_text(f'{PROBLEM}[path]\ntable = "poses.csv"\n')
    said = told(capsys, "solve", file)
    assert "path.table: needs a section" in said
    assert 'Write file = "poses.csv" in a section [path.table].' in said
