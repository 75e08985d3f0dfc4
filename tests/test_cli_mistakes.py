"""What people type by mistake, and the sentence that they get."""

import re

import pytest
from small_arms import ROOT

from stiffopt.cli import run

PROBLEM = str(ROOT / "problems" / "two_link.toml")
ROBOT = str(ROOT / "problems" / "two_link_robot.toml")
URDF = str(ROOT / "problems" / "two_link.urdf")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["solve", URDF], r"is no TOML but XML, such as a URDF\. `stiffopt init robot"),
        (["solve", ROBOT], r"got 'robot'\. `stiffopt init problem ROBOT` writes a problem"),
        (["solve", PROBLEM, "--set", "payload=3"], r"payload: needs a section .* keys: mass, com"),
        (["export", PROBLEM, "--to", "csv"], r"two_link\.toml: is a file: give the folder"),
        (["export", "nowhere", "--to", "csv"], r": nowhere/result\.json: there is no folder"),
        (
            ["export", "here", "--to", "csv", "--set", "a=1"],
            r"--set 'a=1': a folder of results has",
        ),
        (["simulate", "here", "--set", "a=1"], "Run solve again with --set"),
        (["compare", "here", "here", "--set", "a=1"], "has no entries to change"),
        (["view", "here", "--set", "a=1"], "has no entries to change"),
        (["recording", "check", "a", "b"], "check: unexpected argument 'b'"),
        (["verify", PROBLEM, "--set", "motion.durations=2"], r"motion.durations.*Did you mean"),
    ],
)
def test_sentences(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    errors = capsys.readouterr().err
    assert re.search(said, errors), errors
    assert "is no JSON text" not in errors


def test_verify_of_a_changed_file(capsys):
    """Twice the time, an eighth of the integral: the expected value is no longer met."""
    assert run(["verify", PROBLEM, "--quiet", "--set", "motion.duration=2 s"]) == 1
    assert "0.0131" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("flange", "said"),
    [
        (("--circle", "63"), r'circle = 63 cannot .* at most 3.*bare number is in m: .* "63 mm"'),
        (("--circle", "63 mm", "--count", "40"), "40 heads of 8.5 mm do not fit on a circle of 63"),
        (("--circle", "63 mm", "--torque", "120 N"), "unit 'N' is not one of torque"),
    ],
)
def test_flanges_that_cannot_be(flange, said, tmp_path, capsys):
    assert run(["init", "flange", "--out", str(tmp_path / "f"), *flange]) == 2
    assert re.search(said, capsys.readouterr().err)
    assert not (tmp_path / "f").exists()


def test_bare_millimetres_of_a_bolt_circle_in_a_robot_file(tmp_path, capsys):
    """A circle of 63 m once gave "tighten to 5.18 N m", and nothing else was said."""
    folder = tmp_path / "f"
    assert run(["init", "flange", "--out", str(folder), "--circle", "63 mm"]) == 0
    path = folder / "flange_robot.toml"
    path.write_text(path.read_text().replace("circle_diameter = 0.063", "circle_diameter = 63"))
    assert run(["preload", str(folder / "flange.toml"), "--out", str(tmp_path / "out")]) == 2
    assert 'Write "63 mm" if that is meant' in capsys.readouterr().err


def test_loads_that_decide_nothing_are_asked_about(tmp_path, capsys):
    folder = tmp_path / "f"
    assert run(["init", "flange", "--out", str(folder), "--torque", "120 mN*m"]) == 0
    assert run(["preload", str(folder / "flange.toml"), "--out", str(tmp_path / "out")]) == 0
    said = re.sub(r"\s+", " ", capsys.readouterr().out)
    assert "the loads are negligible" in said
