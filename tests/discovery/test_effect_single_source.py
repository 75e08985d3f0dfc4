"""A new effect is picked up from its file by every check, report and page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from diagnosed_folders import columns_of, command, copied
from simulated_sets import COULOMB
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.extended.model import load_extended
from stiffopt.discovery.extended.planning import planner_model
from stiffopt.discovery.user_effects import load_effects
from stiffopt.errors import InputFileError
from stiffopt.recording.recording_set import load_recordings
from stiffopt.report.catalogue_page import catalogue_page

WAVE = 3.0
FILE = '''
"""An effect that exists nowhere else."""

from dataclasses import replace

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, RobotChange, Term


def as_friction(robot, found, joint, constants):
    """Counts the wave's height as dry friction."""
    coulomb = robot.coulomb.copy()
    coulomb[joint] += found.amplitudes[0]
    return RobotChange(replace(robot, coulomb=coulomb), f"Joint {joint + 1}: a wave as friction.")


RAIL_WAVE = Effect(
    name="rail_wave",
    family="friction",
    scope="joint",
    equation="tau += A*sin(9*q)",
    signature="torque that waves along the stroke",
    phrase="a wavy rail",
    needs=("torque", "moves", "pole_pairs"),
    confused_with=("position_friction",),
    reference="Notes of the workshop, 2026",
    change_robot=as_friction,
    term=lambda s, a, v: Term(drive_torque=a[0] * np.sin(9.0 * s.motor_position)),
    amplitudes=(Amplitude(name="A", unit="N m", scale=1.0, lower=-10.0, upper=10.0),),
)
'''


@pytest.fixture(scope="module")
def wavy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A set whose second joint has the effect, and the file of the effect."""
    folder = tmp_path_factory.mktemp("wavy")
    source = copied(COULOMB, folder / "set")
    for file in source.glob("*.npz"):
        columns = columns_of(file)
        columns["tau2"] = columns["tau2"] + WAVE * np.sin(9.0 * columns["q2"])
        np.savez_compressed(file, **columns)
    effects = folder / "mine.py"
    effects.write_text(FILE)
    return source, effects


def test_recording_check_includes_needs_of_new_effect(
    wavy: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    source, effects = wavy
    assert run(["recording", "check", str(source), "--effects", str(effects), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["effects"]
    checks = [each for each in found if each["effect"] == "rail_wave"]
    assert [each["joint"] for each in checks] == [1, 2]
    assert {tuple(each["lacks"]) for each in checks} <= {(), ("nominal.pole_pairs is not given",)}
    assert run(["recording", "check", str(source), "--effects", str(effects)]) == 0
    assert "rail_wave: " in capsys.readouterr().out


def test_diagnosis_report_and_planner_include_new_effect(wavy: tuple[Path, Path]) -> None:
    source, effects = wavy
    answer = command(source, "--effects", str(effects), "--no-experiment")
    found = {(f["effect"], f["joint"]): f for f in answer.document["findings"]}
    assert found[("rail_wave", 2)]["parameters"]["A"]["value"] == pytest.approx(WAVE, rel=0.1)
    page = (answer.out / "report.html").read_text(encoding="utf-8")
    assert "a wavy rail" in page
    assert "tau += A*sin(9*q)" in page
    assert "Notes of the workshop, 2026" in page
    text = (answer.out / "extended.toml").read_text(encoding="utf-8")
    assert 'name = "rail_wave"' in text
    with pytest.raises(InputFileError, match="A user's own effect needs its Python file"):
        load_extended(answer.out / "extended.toml")
    robot = load_recordings(source).robot
    model = load_extended(answer.out / "extended.toml", load_effects(effects))
    planner = planner_model(robot, model)
    assert "Joint 2: a wave as friction." in planner.changes
    assert planner.robot.coulomb[1] > robot.coulomb[1] + 0.9 * WAVE


def test_catalogue_page_includes_new_effect(wavy: tuple[Path, Path]) -> None:
    page = catalogue_page((*CATALOGUE, *load_effects(wavy[1])))
    (line,) = [line for line in page.splitlines() if line.startswith("| `rail_wave` |")]
    assert "torque, motion, pole pairs" in line
    assert "`position_friction`" in line
    assert "Notes of the workshop" in line


def test_committed_catalogue_page_is_current() -> None:
    written = (ROOT / ".github" / "catalogue.md").read_text(encoding="utf-8")
    assert written == catalogue_page(), "python -m stiffopt.report.catalogue_page writes it anew"
    rows = [line for line in written.splitlines() if line.startswith("| `")]
    assert all(row.count(" | ") == 8 for row in rows)
