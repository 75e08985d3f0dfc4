"""Bags and MCAP files to begin with: joint topics found by what their messages hold."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from recording_sets import URDF, motion
from test_recording_readers import write_bag, write_json_mcap

from stiffopt.cli import run
from stiffopt.errors import InputError
from stiffopt.recording.recording_set import load_recordings
from stiffopt.starter.table_layouts import STAMP_COLUMN, read_message_table

pytest.importorskip("rosbags")
pytest.importorskip("mcap")


@pytest.fixture(scope="module")
def recorded():
    return motion(rate=100.0, duration=12.0)


@pytest.mark.parametrize("kind", ["bag of sqlite", "bag of mcap", "mcap of json"])
def test_joint_states_become_a_table(kind, recorded, tmp_path):
    path = tmp_path / ("run.mcap" if kind == "mcap of json" else "bag")
    if kind == "mcap of json":
        write_json_mcap(path, recorded)
    else:
        write_bag(path, recorded, sqlite=kind == "bag of sqlite")
    table = read_message_table(path, ("swing", "slide"))
    assert table[STAMP_COLUMN] == pytest.approx(recorded["t"] - recorded["t"][0], abs=1e-8)
    assert table["/joint_states.effort[slide]"] == pytest.approx(recorded["tau2"])


def test_a_bag_becomes_a_set(recorded, tmp_path, capsys):
    write_bag(tmp_path / "bag", recorded, sqlite=True)
    (tmp_path / "robot.urdf").write_text(URDF)
    arguments = ["init", "recording", str(tmp_path / "bag")]
    assert run([*arguments, "--urdf", str(tmp_path / "robot.urdf")]) == 0
    said = capsys.readouterr().out
    assert "/joint_states.position[swing], /joint_states.position[slide]" in said
    folder = tmp_path / "bag_set"
    signals = tomllib.loads((folder / "recordings.toml").read_text())["signals"]
    assert signals["torque"] == ["/joint_states.effort[swing]", "/joint_states.effort[slide]"]
    assert signals["velocity"] == ["/joint_states.velocity[swing]", "/joint_states.velocity[slide]"]
    assert [each.role for each in load_recordings(folder).runs] == ["train", "test"]


def test_joints_without_topic_are_refused(recorded, tmp_path):
    write_json_mcap(tmp_path / "run.mcap", {k: v[:50] for k, v in recorded.items()})
    with pytest.raises(InputError, match=r"no topic among /joint_states has lists .* elbow"):
        read_message_table(tmp_path / "run.mcap", ("shoulder", "elbow", "wrist"))


def test_slow_reader_is_stopped(tmp_path, monkeypatch):
    """As one that follows a loop in a file would."""
    from stiffopt.recording.readers import checks, read
    from stiffopt.recording.readers import csv as reader
    from stiffopt.recording.signals import Signals

    def endless(*_):
        while True:
            np.zeros(10)

    monkeypatch.setattr(checks, "MAX_SECONDS", 0.3)
    monkeypatch.setattr(reader, "read", endless)
    (tmp_path / "run.csv").write_text("t,q,tau\n0,0,0\n")
    signals = Signals(time="t", position=("q",), velocity=None, link_position=None, torque=("tau",))
    with pytest.raises(InputError, match=r"cannot be read as a text file within 0\.3 s"):
        read.read_columns(tmp_path / "run.csv", signals)
