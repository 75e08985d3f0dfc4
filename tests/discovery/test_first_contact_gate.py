"""What a first recording must not be refused for, and what stays unknown in the lines to paste."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from shipped_set import SHIPPED
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.discovery.comparison.channel_rows import ChannelNoise, KnownNoise, known_noise
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import prepare_run
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.sanity.doubt import format_shares, scale_line
from stiffopt.discovery.sanity.gate import SanityGate
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import open_training_runs
from stiffopt.recording.recording_set import load_recordings

SHARED = ROOT.parent / "shared" / "cases"


def changed(folder: Path, change) -> Path:
    shutil.copytree(SHIPPED, folder)
    for file in sorted(folder.glob("*.npz")):
        with np.load(file) as stored:
            columns = dict(stored)
        np.savez(file, **(change(file.stem, columns) or columns))
    return folder


def doubts(folder: Path):
    recordings = load_recordings(folder)
    return SanityGate(recordings, open_training_runs(recordings)).doubts


def test_a_joint_that_is_not_driven_has_no_other_unit(tmp_path):
    """Commanded to zero: what is left is 1/2000 of the torque, with the other sign."""

    def idle(_, columns):
        columns["tau2"] = -5e-4 * columns["tau2"]

    assert not [
        each for each in doubts(changed(tmp_path / "set", idle)) if each.kind == "torque unit"
    ]


def test_a_unit_of_all_torques_is_still_told(tmp_path):
    def kilo(_, columns):
        for name in ("tau1", "tau2"):
            columns[name] = 1e-3 * columns[name]

    found = doubts(changed(tmp_path / "set", kilo))
    assert any("looks like kN m" in each.evidence for each in found)


@pytest.mark.parametrize(("seconds", "refused"), [(0.95, False), (60.0, True)])
def test_a_short_run_is_no_ground_to_refuse(seconds, refused, tmp_path):
    """The torque of joint 2 is reversed in one run, which is named where it is long enough."""

    def reverse(name, columns):
        if name == "train_2":
            rows = columns["t"] - columns["t"][0] <= seconds
            columns["tau2"] = -columns["tau2"]
            return {key: column[rows] for key, column in columns.items()}
        return None

    found = doubts(changed(tmp_path / "set", reverse))
    assert bool(found) == refused
    assert all("train_2" in each.evidence for each in found)


def test_one_joint_that_is_still_a_current_is_named(tmp_path, capsys):
    """As the line to paste leaves it where the weight does not tell its factor."""
    folder = changed(tmp_path / "set", lambda *_: None)
    recordings = load_recordings(folder)
    line = scale_line(recordings, "torque", np.array([9.5, 1.0]), unknown=np.array([False, True]))
    assert line.startswith('torque = [9.5, "A"] in [signals.scale] (the weight does not tell')
    assert "joint 2" in line
    file = folder / "recordings.toml"
    file.write_text(file.read_text() + '\n[signals.scale]\ntorque = [1.0, "A"]\n')
    assert run(["recording", "check", str(folder)]) == 0
    told = capsys.readouterr().out
    assert "The torque of joint 2 is stated in A, and the weight does not tell" in told
    assert "left out of a diagnosis" in told


def test_a_current_without_a_known_factor_is_left_out_of_the_diagnosis(tmp_path):
    """Its residual depends on the factor: nothing may be read from it, refusals neither."""

    def scaled(_, columns):
        columns["tau2"] = 3.0 * np.sign(np.sin(7.0 * columns["t"]))

    folder = changed(tmp_path / "set", scaled)
    file = folder / "recordings.toml"
    file.write_text(file.read_text() + '\n[signals.scale]\ntorque = [1.0, "A"]\n')
    found = diagnose(folder, experiment=False)
    assert found.recordings.signals.torque[1] == ""
    assert np.isnan(found.training.recorded[0].torque[:, 1]).all()
    assert not any(each.located.joint == 2 for each in found.findings)


def test_the_line_to_paste_for_currents_keeps_the_wrist_unknown(tmp_path, capsys):
    """Motor currents of six joints, of which the weight tells four."""
    log = SHARED / "logs" / "excel.csv"
    if not log.is_file():
        pytest.skip("the folder of shared logs is absent")
    urdf, out = SHARED / "diagnosis" / "zero_offset" / "robot.urdf", tmp_path / "set"
    assert run(["init", "recording", str(log), "--urdf", str(urdf), "-o", str(out)]) == 0
    assert run(["recording", "check", str(out)]) == 2
    assert '8.74, "A", "A"] in [signals.scale]' in capsys.readouterr().err


@pytest.mark.parametrize("count", [0.02, 0.5])
def test_counts_of_a_torque_are_part_of_its_noise(count, tmp_path):
    def rounded(_, columns):
        # A smooth torque: noise of its own would hide the counts.
        columns["tau2"] = count * np.round(3.0 * np.sin(columns["t"] / 4.0) / count)

    recordings = load_recordings(changed(tmp_path / "set", rounded), ["noise.torque=[0.2, 0]"])
    robot = RobotModel(recordings)
    runs = [
        prepare_run(robot, each, k, None, Settings())
        for k, each in enumerate(open_training_runs(recordings))
    ]
    assert known_noise(recordings.noise, runs).channels.torque[1] >= 0.99 * count / np.sqrt(12.0)


def test_noise_of_a_sliding_joint_is_a_force():
    channels = ChannelNoise(torque=np.array([8.0, 2.0]), deflection=np.full(2, np.nan))
    noise = KnownNoise(
        channels=channels, torque_stated=np.zeros(2, bool), deflection_stated=np.ones(2, bool)
    )
    (told,) = noise.assumptions(np.array([True, False]))
    assert "(joint 1: 8 N, 2: 2 N m)" in told


def test_residual_shares_are_percentages():
    told = format_shares(np.array([9.6, 0.64]), np.array([2.9e-4, 0.012]), [0, 1])
    assert "0.029 % at joint 1 (as described 960 %), 1.2 % at joint 2 (as described 64 %)" in told


def test_residual_shares_stay_readable():
    told = format_shares(np.array([2e6, 12.0]), np.array([3e-9, 0.5]), [0, 1])
    assert "under 0.01 % at joint 1 (as described over 1,000 %)" in told
    assert "50 % at joint 2 (as described over 1,000 %)" in told
