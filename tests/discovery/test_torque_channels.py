"""Dead torque channels, and torques that repeat to the digit, are doubted before a diagnosis."""

import shutil

import numpy as np
import pytest
from simulated_sets import short_case, simulated

from benchmarks.simulator import write_case
from stiffopt.discovery.sanity.gate import SanityGate
from stiffopt.discovery.training import open_training_runs
from stiffopt.recording.recording_set import load_recordings


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    case = simulated(short_case(seed=71, robot="small3", train=2))
    return write_case(case, tmp_path_factory.mktemp("channels") / "set")


def doubts_with(folder, there, change):
    """Doubts about the set after a change (columns, number of the run) of its runs."""
    shutil.copytree(folder, there)
    for number, file in enumerate(sorted(there.glob("train*.npz"))):
        with np.load(file) as stored:
            columns = dict(stored)
        change(columns, number)
        np.savez(file, **columns)
    recordings = load_recordings(there)
    return SanityGate(recordings, open_training_runs(recordings)).doubts


def test_healthy_channels_are_not_doubted(healthy, tmp_path):
    assert doubts_with(healthy, tmp_path / "same", lambda columns, number: None) == ()


def test_dead_channel_is_told_with_the_line_that_leaves_it_out(healthy, tmp_path):
    noise = np.random.default_rng(5)

    def die(columns, number):
        columns["tau2"] = 0.02 * noise.standard_normal(len(columns["t"]))

    (doubt,) = doubts_with(healthy, tmp_path / "dead", die)
    assert (doubt.kind, doubt.joints) == ("dead channel", (2,))
    assert doubt.line == 'torque = ["tau1", "", "tau3"] in [signals]'


def test_torque_that_repeats_to_the_digit_is_told_as_commanded(healthy, tmp_path):
    with np.load(healthy / "train_1.npz") as stored:
        columns = dict(stored)
    noise = np.random.default_rng(6)

    def repeat(own, number):
        own.update(columns)
        for name in ("q1", "q2", "q3"):
            own[name] = own[name] + 1e-5 * noise.standard_normal(len(own[name]))

    (doubt,) = doubts_with(healthy, tmp_path / "repeat", repeat)
    assert (doubt.kind, doubt.joints) == ("commanded torque", (1, 2, 3))


def test_copied_run_is_told(healthy, tmp_path):
    with np.load(healthy / "train_1.npz") as stored:
        columns = dict(stored)
    (doubt,) = doubts_with(healthy, tmp_path / "copy", lambda own, number: own.update(columns))
    assert doubt.kind == "repeated run"
