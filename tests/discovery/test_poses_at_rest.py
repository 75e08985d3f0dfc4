"""Poses at rest: recognised, weight estimated, and what they cannot show is told."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.user_effects import acts_at_rest
from stiffopt.errors import InputFileError
from stiffopt.recording.check import check_recordings
from stiffopt.recording.clock import are_unordered
from stiffopt.recording.recording_set import load_recordings
from stiffopt.report.diagnosis.page import write_diagnosis_report
from stiffopt.report.recording_check import report_lines
from stiffopt.starter.recording_set import start_recording_set
from tests.discovery.test_states_of_a_robot import UPRIGHT

CASE = Path(__file__).parents[2] / "../shared/cases/diagnosis/poses_averaged"


def _write_poses(
    folder: Path, seed: int, payload: float = 0.0, gain: float = 1.0, count: int = 50
) -> Path:
    """Write poses of the upright arm, held within the band of its dry friction."""
    model = pin.buildModelFromXML(UPRIGHT.urdf)
    if payload:
        last = model.inertias[model.njoints - 1]
        model.inertias[model.njoints - 1] = last + pin.Inertia(
            payload, last.lever, np.eye(3) * 1e-3
        )
    data, rng = model.createData(), np.random.default_rng(seed)

    def record(logs: list) -> None:
        for number in range(len(logs)):
            q = rng.uniform(-1.5, 1.5, (count, 3))
            weight = np.array([pin.computeGeneralizedGravity(model, data, each) for each in q])
            weight[:, 1] *= gain
            held = rng.uniform(-0.4, 0.4, q.shape) * UPRIGHT.coulomb
            logs[number] = {
                "t": np.arange(1.0, count + 1.0),
                "q": q,
                "v": 0.0 * q,
                "tau": weight + held,
            }

    return UPRIGHT.write(folder, record)


def test_payload_shows_in_poses(tmp_path):
    found = diagnose(_write_poses(tmp_path / "set", 3, payload=2.0))
    (finding,) = found.findings
    assert finding.effect.name == "payload"
    mass = finding.parameters[0]
    assert mass.value == pytest.approx(2.0, abs=3.0 * mass.sd)
    assert mass.sd < 0.3
    assert found.nrmse("test")[1] < 1.15
    assert any("direction is unknown" in each for each in found.assumptions)
    # Friction uniform within 0.4 of the dry friction.
    scatter = found.training.noise.channels.torque
    np.testing.assert_allclose(scatter, 0.4 * np.array(UPRIGHT.coulomb) / np.sqrt(3.0), rtol=0.15)
    assert "Poses at rest" in write_diagnosis_report(found, tmp_path).read_text()


def test_torque_scale_shows_in_poses(tmp_path):
    found = diagnose(_write_poses(tmp_path / "set", 4, gain=1.25))
    assert [(f.effect.name, f.joint) for f in found.findings] == [("torque_gain", 2)]
    (value,) = found.findings[0].parameters
    assert value.value == pytest.approx(0.25, abs=4.0 * value.sd)


def test_nothing_is_found_in_nominal_poses(tmp_path):
    found = diagnose(_write_poses(tmp_path / "set", 5))
    assert found.verdict == "nothing_missing"
    limits = {limit.effect.name for limit in found.detection_limits}
    assert "torque_gain" in limits
    assert not limits & {"coulomb", "viscous", "rotor_inertia", "time_delay"}


@pytest.mark.parametrize(
    ("name", "acts"),
    [
        ("payload", True),
        ("gravity_spring", True),
        ("torque_gain", True),
        ("base_tilt", True),
        ("coulomb", False),
        ("rotor_inertia", False),
        ("time_delay", False),
    ],
)
def test_effects_that_act_at_rest(name, acts):
    assert acts_at_rest(effect(name)) == acts


def test_check_and_first_set_recognise_poses(tmp_path):
    recordings = load_recordings(_write_poses(tmp_path / "set", 6, count=20))
    text = "\n".join(report_lines(check_recordings(recordings), ()))
    assert "run_1.csv (train): 20 poses at rest" in text
    files = [tmp_path / "set" / f"run_{k}.csv" for k in (1, 2, 3, 4)]
    start_recording_set(files, tmp_path / "set" / "robot.urdf", tmp_path / "first")
    written = (tmp_path / "first" / "recordings.toml").read_text()
    assert "at_rest = true" in written
    assert load_recordings(tmp_path / "first").signals.at_rest


def test_motions_are_no_poses():
    t = np.linspace(0.0, 10.0, 60)
    assert not are_unordered(np.column_stack([np.sin(t), np.cos(2.0 * t)]))
    assert are_unordered(np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3)))


def test_poses_beside_motion_are_refused(tmp_path):
    folder = _write_poses(tmp_path / "set", 7)
    moving = UPRIGHT.write(tmp_path / "moving")
    (folder / "run_2.csv").write_bytes((moving / "run_2.csv").read_bytes())
    with pytest.raises(InputFileError, match=r"run_1.csv, run_3.csv: poses at rest; run_2.csv"):
        diagnose(folder)


def test_too_few_poses_are_refused(tmp_path):
    folder = _write_poses(tmp_path / "set", 8, count=4)
    text = (folder / "recordings.toml").read_text()
    (folder / "recordings.toml").write_text(text.replace("[signals]", "[signals]\nat_rest = true"))
    with pytest.raises(InputFileError, match="holds 4 poses at rest"):
        diagnose(folder)


@pytest.mark.skipif(not CASE.is_dir(), reason="the shared cases are absent")
def test_payload_in_gravity_table_of_large_arm():
    found = diagnose(CASE)
    (finding,) = found.findings
    assert finding.effect.name == "payload"
    values = {p.name: p for p in finding.parameters}
    assert values["dm"].value == pytest.approx(1.5, abs=3.0 * values["dm"].sd)
    assert values["cz"].value == pytest.approx(0.08, abs=3.0 * values["cz"].sd)
