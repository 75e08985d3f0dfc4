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
        (["export", "here", "--to", "csv", "--set", "a=1"], r"--set 'a=1': a folder of results is"),
        (["simulate", "here", "--set", "a=1"], "Solve, study or diagnose again with --set"),
        (["compare", "here", "here", "--set", "a=1"], "has no entries to change"),
        (["view", "here", "--set", "a=1"], "has no entries to change"),
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
