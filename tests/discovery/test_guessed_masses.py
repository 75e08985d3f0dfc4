"""An arm whose URDF gives no masses, as most of ROS-Industrial: they are guessed, and free."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from own_machines import Log, Machine, joint, link

from stiffopt.discovery.diagnose import Diagnosis, diagnose
from stiffopt.discovery.sanity.gate import SanityGate
from stiffopt.discovery.training import open_training_runs
from stiffopt.recording.recording_set import load_recordings
from stiffopt.starter.recording_set import start_recording_set

LOAD_FRICTION, DRAG = 0.08, 3.0
# Upper arm and forearm weigh about three times what is guessed of rods of their lengths.
ARM = Machine(
    name="arm",
    urdf="".join(
        [
            '<robot name="arm"><link name="base"/>',
            link("upper", 13.0, "0.2 0.03 0.02"),
            link("fore", 7.0, "0.16 -0.02 0.01"),
            link("hand", 1.0, "0.02 0 0.05"),
            joint("shoulder", "revolute", "base upper", "0 0 0.4", "0 1 0", (-2, 2, 0, 3)),
            joint("elbow", "revolute", "upper fore", "0.4 0 0", "0 1 0", (-2.4, 2.4, 0, 4)),
            joint("wrist", "revolute", "fore hand", "0.3 0 0", "0 0 1", (-3, 3, 0, 6)),
            "</robot>",
        ]
    ),
    joints=("shoulder", "elbow", "wrist"),
    middle=(0.0, 0.4, 0.0),
    swing=(1.1, 1.4, 2.0),
    coulomb=(4.0, 2.0, 0.4),
    viscous=(3.0, 1.5, 0.2),
    noise=(0.2, 0.12, 0.03),
)


def rubs_under_load(logs: list[Log]) -> None:
    """Friction of the shoulder grows with its load."""
    for log in logs:
        turns = np.tanh(log["v"] / 0.01)
        load = log["tau"] - np.array(ARM.coulomb) * turns - np.array(ARM.viscous) * log["v"]
        log["tau"][:, 0] += LOAD_FRICTION * np.abs(load[:, 0]) * turns[:, 0]


def drags_once(logs: list[Log]) -> None:
    """The wrist's brake drags in the second run."""
    log = logs[1]
    log["tau"][:, 2] += DRAG * np.tanh(log["v"][:, 2] / 0.01)


def without_masses(logs: Path, folder: Path) -> Path:
    """A set started from logs and a URDF without inertials."""
    urdf = logs / "robot.urdf"
    urdf.write_text(re.sub("<inertial>.*?</inertial>", "", urdf.read_text()))
    start_recording_set([logs / f"run_{k}.csv" for k in range(1, 5)], urdf, folder)
    return folder


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    folder = tmp_path_factory.mktemp("guessed")
    ARM.write(folder / "logs", rubs_under_load)
    return diagnose(without_masses(folder / "logs", folder / "set"), experiment=False)


def test_load_of_reidentified_masses_is_that_of_load_friction(diagnosis: Diagnosis) -> None:
    """The load by guessed masses is a third of it, and would make the friction as much larger."""
    (finding,) = (each for each in diagnosis.findings if each.effect.name == "load_friction")
    assert finding.joint == 1
    (mu,) = finding.parameters
    assert abs(mu.value - LOAD_FRICTION) < 3.0 * mu.sd < 0.3 * LOAD_FRICTION


def test_masses_explain_held_out_run(diagnosis: Diagnosis) -> None:
    (proof,) = diagnosis.held_out
    assert proof.nrmse_after < 1.1


def test_run_with_other_friction_is_no_other_arm(tmp_path: Path) -> None:
    ARM.write(tmp_path / "logs", drags_once)
    folder = without_masses(tmp_path / "logs", tmp_path / "set")
    recordings = load_recordings(folder)
    assert SanityGate(recordings, open_training_runs(recordings)).doubts == ()
