"""Controllers of commanded joints: integral part, and damping that nobody states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from servo_sets import COULOMB, KP, VISCOUS, state_drive, write_servo_set

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.position_fit import fit_positions, simulate_held_out
from stiffopt.discovery.sanity.actuator_estimate import (
    estimate_actuator,
    integral_rate,
    joint_rows,
    resolve_actuator,
)
from stiffopt.discovery.training import open_training_runs
from stiffopt.recording.recording_set import load_recordings


@pytest.mark.parametrize("rate", [0.0, 0.5, 2.0])
def test_an_integral_part_is_told_from_errors_that_fade(tmp_path: Path, rate: float) -> None:
    """Gains and delay need not be known."""
    found = load_recordings(write_servo_set(tmp_path / "set", integral=rate))
    runs = open_training_runs(found)
    law = estimate_actuator(RobotModel(found), runs, found.actuator).law
    told, spread, _ = integral_rate(joint_rows(RobotModel(found), runs, 0), law.delay)
    assert abs(told - rate) < max(0.1 * rate, 3.0 * spread)
    assert law.integral.any() == (rate > 0.0)


@pytest.mark.parametrize("rate", [0.5, 2.0])
def test_an_integral_part_acts_in_the_simulation(tmp_path: Path, rate: float) -> None:
    """Errors of 30 mrad and more fade; without the integral part they would last."""
    found = load_recordings(write_servo_set(tmp_path / "set", integral=rate))
    own = resolve_actuator(found, open_training_runs(found))
    assert any("integral part" in note for note in own.notes)
    model = fit_positions(own.recordings, own.runs, None, own.parameters)
    assert model is not None
    value, sd = model.fitted.of("integral")[0], model.deviations[model.fitted.place("integral")][0]
    assert abs(value - rate) < max(2.5 * sd, 0.01 * rate)
    gain = model.loop.law.stiffness[0] * (1.0 + model.fitted.of("gain")[0])
    assert gain == pytest.approx(KP, rel=0.02)
    (run,) = simulate_held_out(own.recordings, model)
    assert np.sqrt(np.mean((run.after - run.measured) ** 2)) < 1e-4  # [rad]


def test_torques_of_an_integral_part_carry_the_weight(tmp_path: Path) -> None:
    found = load_recordings(write_servo_set(tmp_path / "set", integral=2.0))
    own = resolve_actuator(found, open_training_runs(found))
    (weight,) = RobotModel(own.recordings).spring_torque(*[np.zeros((1, 1))] * 3)[0]
    for run in own.runs:
        mean = RobotModel(own.recordings).spring_torque(run.position, *[0.0 * run.position] * 2)
        assert np.nanmean(run.torque) == pytest.approx(np.nanmean(mean), abs=1e-6 + abs(weight))


def test_viscous_friction_is_unknown_where_the_drives_damping_is(tmp_path: Path) -> None:
    """A tenth of what damps the joint is stated as its viscous friction."""
    path = write_servo_set(tmp_path / "set", actuator=f"kp = [{KP}]")
    state_drive(path)
    file = path / "recordings.toml"
    text = file.read_text(encoding="utf-8")
    assert f"viscous = [{VISCOUS}]" in text
    file.write_text(text.replace(f"viscous = [{VISCOUS}]", f"viscous = [{0.1 * VISCOUS}]"), "utf-8")
    found = load_recordings(path)
    assert found.unstated == ("viscous",)
    assert found.robot.viscous[0] == 0.0
    model = fit_positions(*_resolved(found))
    assert model is not None
    assert model.fitted.of("viscous")[0] == pytest.approx(VISCOUS, rel=0.03)
    stated = load_recordings(path, ["actuator.kd=[0.0]"])
    assert "viscous" not in stated.unstated


def test_a_deadband_is_told_from_dry_friction(tmp_path: Path) -> None:
    """Twice as wide as the error that dry friction leaves."""
    width = 2.0 * COULOMB / KP
    folder = write_servo_set(
        tmp_path / "set", actuator=f"kp = [{KP}]\nkd = [0.0]\ntolerance = 0.01", deadband=width
    )
    state_drive(folder)
    found = diagnose(folder, experiment=False)
    (finding,) = found.findings
    assert finding.effect.name == "deadband"
    (told,) = finding.parameters
    assert told.sd is not None
    assert abs(told.value - width) < 2.5 * told.sd < 0.05 * width
    (run,) = found.positions
    assert np.std(run.after - run.measured) < 1e-4 < 0.1 * np.std(run.before - run.measured)


def _resolved(found):
    own = resolve_actuator(found, open_training_runs(found))
    return own.recordings, own.runs, None, own.parameters
