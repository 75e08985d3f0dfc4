"""Commanded positions in place of torques: reading, units, torques by the actuator's law."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from servo_sets import KP, write_servo_set

from stiffopt.errors import InputFileError
from stiffopt.recording.recording_set import load_recordings


def test_torques_follow_from_commands(tmp_path: Path) -> None:
    folder = write_servo_set(tmp_path / "set", actuator=f"kp = [{KP}]\nkd = [0.2]\ndelay = 0.0")
    found = load_recordings(folder)
    run = found.open(found.runs[0])
    assert run.command is not None
    # A command means itself over a row in whose middle it does not change.
    held = np.flatnonzero(np.diff(run.command[:, 0]) == 0.0)[1:-1] + 1
    velocity = np.gradient(run.position[:, 0], run.time)
    expected = KP * (run.command[:, 0] - run.position[:, 0]) - 0.2 * velocity
    assert len(held) > 300
    np.testing.assert_allclose(run.torque[held, 0], expected[held], atol=1e-9)


def test_commands_have_the_unit_of_positions_unless_stated(tmp_path: Path) -> None:
    scale = '[signals.scale]\nposition = "deg"'
    same = load_recordings(write_servo_set(tmp_path / "same", signals=scale))
    np.testing.assert_allclose(same.signals.scale_of("command", 1), np.pi / 180.0)
    own = load_recordings(write_servo_set(tmp_path / "own", signals=f"{scale}\ncommand = 1.0"))
    np.testing.assert_allclose(own.signals.scale_of("command", 1), 1.0)


def test_unknown_gain_leaves_torques_missing_when_read(tmp_path: Path) -> None:
    found = load_recordings(write_servo_set(tmp_path / "set"))
    assert np.isnan(found.open(found.runs[0]).torque).all()


def test_a_set_without_torques_and_commands_is_refused(tmp_path: Path) -> None:
    folder = write_servo_set(tmp_path / "set")
    file = folder / "recordings.toml"
    text = file.read_text(encoding="utf-8").replace('command = ["goal_position"]', "")
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputFileError, match="no joint has a torque or a command"):
        load_recordings(folder)


def test_an_actuator_needs_commands(tmp_path: Path) -> None:
    folder = write_servo_set(tmp_path / "set", actuator="kp = [9.0]")
    file = folder / "recordings.toml"
    text = file.read_text(encoding="utf-8").replace(
        'command = ["goal_position"]', 'torque = ["goal_position"]'
    )
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputFileError, match="needs commanded positions"):
        load_recordings(folder)
