"""Diagnoses of commanded and measured positions without torque."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from servo_sets import (
    ARMATURE,
    COULOMB,
    DELAY,
    INERTIA,
    KP,
    LEVER,
    MASS,
    VISCOUS,
    state_drive,
    write_servo_set,
)

from stiffopt.cli import run as run_command
from stiffopt.closed_loop.simulation import CommandedRun, simulate
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import GAIN, joint_columns
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.discovery.experiment.motion import motion_commands
from stiffopt.discovery.extended.value_changes import extended_model
from stiffopt.discovery.identifiable import effect_checks
from stiffopt.discovery.loop_fit import build_loop, nominal_parameters
from stiffopt.discovery.position_fit import (
    ClosedLoopModel,
    fit_positions,
    model_section,
    read_model,
    simulate_run,
)
from stiffopt.discovery.sanity.actuator_estimate import (
    estimate_actuator,
    resolve_actuator,
)
from stiffopt.discovery.sanity.command_doubts import (
    _doubt_units,
    doubt_commands,
    take_errors_as_commands,
)
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import open_training_runs, prepare_training
from stiffopt.errors import InputError
from stiffopt.recording.joint_facts import joint_facts
from stiffopt.recording.recording_set import RecordingSet, load_recordings
from stiffopt.report.diagnosis.positions import value_section
from stiffopt.result.trajectory import Trajectory

GO2 = Path("../shared/recordings/go2_leg_fl")
CASES = Path("../shared/cases/diagnosis")
Columns = dict[str, np.ndarray]


@pytest.fixture(name="servo", scope="module")
def servo_set(tmp_path_factory: pytest.TempPathFactory) -> RecordingSet:
    """Servo with an unknown gain."""
    return load_recordings(write_servo_set(tmp_path_factory.mktemp("servo") / "set"))


def test_weight_tells_the_gain_and_motion_the_delay(servo: RecordingSet) -> None:
    own = resolve_actuator(servo, open_training_runs(servo))
    resolved, runs, notes = own.recordings, own.runs, own.notes
    law = resolved.actuator
    assert law is not None
    np.testing.assert_allclose(law.stiffness, KP, rtol=0.02)
    assert abs(law.delay - DELAY) < 4e-3  # refined by the simulation
    assert all(np.isfinite(run.torque).all() for run in runs)
    assert any("estimated from the arm's weight" in note for note in notes)


def test_a_gain_that_recordings_told_is_free_beside_effects(servo: RecordingSet) -> None:
    own = resolve_actuator(servo, open_training_runs(servo))
    recordings = replace(own.recordings, tolerance=replace(servo.tolerance, mass=0.02))
    training = prepare_training(recordings, Settings(), None, lambda _: None, own.runs)
    columns = joint_columns(training.runs[0], servo.tolerance, lambda name: name.kind == GAIN)
    (gain,) = columns
    assert gain.sd == 1.0
    assert np.ptp(gain.values) > 1.0  # [N m]


def test_late_commands_change_the_torque_by_their_rate(servo: RecordingSet) -> None:
    late, runs = 0.004, open_training_runs(servo)
    law = replace(resolve_actuator(servo, runs).recordings.actuator, delay=DELAY)
    own = servo.with_actuator(law)
    early, later = (
        prepare_training(
            own,
            Settings(),
            None,
            lambda _: None,
            [
                own.with_actuator(replace(law, delay=DELAY + more)).derive_torque(run)
                for run in runs
            ],
        ).runs[0]
        for more in (0.0, late)
    )
    inside = early.torque_used[:, 0]
    changed = early.low_pass(early.torque - later.torque)[inside, 0]
    rate = early.signals.command_rate[inside, 0]
    error = changed - late * rate
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(changed**2))


def test_a_gain_that_nothing_tells_is_said(tmp_path: Path) -> None:
    folder = write_servo_set(tmp_path / "set", runs=2)
    urdf = folder / "robot.urdf"
    # About a vertical axis nothing weighs, and the inertia is that of any rotor.
    urdf.write_text(urdf.read_text().replace('axis xyz="0 1 0"', 'axis xyz="0 0 1"'))
    found = load_recordings(folder)
    own = resolve_actuator(found, open_training_runs(found))
    resolved, runs, notes = own.recordings, own.runs, own.notes
    assert resolved.actuator is not None
    assert not resolved.actuator.scaled.any()
    assert np.isnan(runs[0].torque).all()
    assert any("only ratios" in note for note in notes)
    with pytest.raises(InputError, match=r"give kp in \[actuator\].*best with kp = \["):
        prepare_training(resolved, Settings(), None, lambda _: None, runs)


def test_a_joint_without_scale_is_simulated_by_its_ratios(tmp_path: Path) -> None:
    folder = write_servo_set(tmp_path / "set", gravity=0.0)
    urdf = folder / "robot.urdf"
    urdf.write_text(urdf.read_text().replace('axis xyz="0 1 0"', 'axis xyz="0 0 1"'))
    found = load_recordings(folder)
    own = resolve_actuator(found, open_training_runs(found))
    assert own.recordings.actuator is not None
    assert not own.recordings.actuator.scaled.any()
    model = fit_positions(own.recordings, own.runs, estimated=own.parameters)
    assert model is not None
    section = model_section(own.recordings, model)
    assert section is not None
    about = INERTIA + MASS * LEVER**2
    for name, true in (("coulomb", COULOMB), ("viscous", VISCOUS)):
        np.testing.assert_allclose(section.ratios[name], true / KP, rtol=0.05)
        # Values have no scale: ratios are told many times better.
        relative = section.deviations[name][0] / section.values[name][0]
        assert section.ratio_deviations[name][0] * KP / true < 0.3 * relative
    assert 0.0 < section.ratios["armature"][0] < (ARMATURE + about) / KP
    lines = value_section(section, np.zeros(1, dtype=bool)).rows
    assert "dry friction over gain" in {line[1] for line in lines}
    (entry,) = found.with_role("test")
    run = simulate_run(own.recordings, model, found.open(entry))
    assert float(np.sqrt(np.mean((run.after - run.measured) ** 2))) < 2e-3


def test_stated_friction_and_rotor_tell_the_gain_of_a_joint_without_weight(tmp_path: Path) -> None:
    folder = write_servo_set(tmp_path / "set", actuator=f"delay = {DELAY}", runs=2, gravity=0.0)
    state_drive(folder)
    urdf, file = folder / "robot.urdf", folder / "recordings.toml"
    urdf.write_text(urdf.read_text().replace('axis xyz="0 1 0"', 'axis xyz="0 0 1"'))
    about = f"[{ARMATURE + INERTIA + MASS * LEVER**2}]"
    file.write_text(file.read_text().replace(f"[{ARMATURE}]", about))
    found = load_recordings(folder)
    assert found.actuator is not None
    runs = open_training_runs(found)
    guess = estimate_actuator(RobotModel(found), runs, found.actuator)
    np.testing.assert_allclose(guess.law.stiffness, KP, rtol=0.1)
    own = resolve_actuator(found, runs)
    assert own.recordings.actuator is not None
    np.testing.assert_allclose(own.recordings.actuator.stiffness, KP, rtol=0.05)


def test_a_position_error_stated_as_torque_is_taken_as_commands(tmp_path: Path) -> None:
    folder = write_servo_set(tmp_path / "set", runs=2)
    for file in folder.glob("*.npz"):
        columns = dict(np.load(file))
        error = 2.0 * (columns["goal_position"] - columns["present_position"])
        np.savez(file, **columns, load=np.round(error, 6))
    text = (folder / "recordings.toml").read_text()
    text = text.replace(
        'command = ["goal_position"]', f'torque = ["load"]\nscale.torque = [{KP / 2}]'
    )
    (folder / "recordings.toml").write_text(text)
    found, notes = take_errors_as_commands(load_recordings(folder))
    assert found.signals.command == ("goal_position",)
    assert found.actuator is not None
    np.testing.assert_allclose(found.actuator.stiffness, KP)
    assert "load is goal_position less present_position" in notes[0]
    own = resolve_actuator(found, open_training_runs(found))
    assert own.recordings.actuator is not None
    assert abs(own.recordings.actuator.delay - DELAY) < 3e-3


def test_a_measured_torque_stays_one(tmp_path: Path) -> None:
    folder = write_servo_set(tmp_path / "set", runs=2)
    for file in folder.glob("*.npz"):
        columns = dict(np.load(file))
        # Proportional to the error up to damping, as a servo's current is.
        speed = np.gradient(columns["present_position"], columns["t"])
        load = columns["goal_position"] - columns["present_position"] - 0.02 * speed
        np.savez(file, **columns, load=load)
    text = (folder / "recordings.toml").read_text()
    (folder / "recordings.toml").write_text(
        text.replace('command = ["goal_position"]', 'torque = ["load"]')
    )
    found, notes = take_errors_as_commands(load_recordings(folder))
    assert found.signals.torque == ("load",)
    assert notes == ()


def test_effects_of_torque_sensors_and_of_unstated_gains_are_not_sought(
    servo: RecordingSet,
) -> None:
    own = resolve_actuator(servo, open_training_runs(servo))
    resolved, runs = own.recordings, own.runs
    checks = effect_checks(resolved, joint_facts(resolved, runs), len(runs))
    possible = {each.effect.name for each in checks if each.possible}
    assert "coulomb" in possible
    assert not possible & {
        "clock_drift",
        "crosstalk",
        "joint_delay",
        "reading_filter",
        "time_delay",
        "torque_gain",
    }


def _swap(columns: Columns) -> Columns:
    return columns | {
        "goal_position": columns["present_position"],
        "present_position": columns["goal_position"],
    }


def _thin(columns: Columns) -> Columns:
    held = np.repeat(columns["goal_position"][::10], 10)
    return columns | {"goal_position": held[: len(columns["t"])]}


def _leave_gaps(columns: Columns) -> Columns:
    sent = np.arange(len(columns["t"])) % 10 == 0
    return columns | {"goal_position": np.where(sent, columns["goal_position"], np.nan)}


def _stop(columns: Columns) -> Columns:
    noise = 1e-5 * np.random.default_rng(0).normal(size=len(columns["t"]))
    return columns | {"present_position": 0.3 + noise, "goal_position": np.full(len(noise), 0.3)}


def test_degrees_of_one_joint_are_a_factor_of_that_joint(servo: RecordingSet) -> None:
    position = np.column_stack([np.linspace(0.0, 1.0, 50), np.linspace(0.5, -0.5, 50)])
    command = position * [1.0, np.degrees(1.0)]
    (doubt,) = _doubt_units(servo, position, command, np.array([True, True]))
    assert doubt.joints == (2,)
    assert doubt.line == "command = [1, 0.0174533] in [signals.scale]"


MISTAKES: dict[str, tuple[Callable[[Columns], Columns], str, str]] = {
    "swapped": (_swap, "swapped", "swapped"),
    "degrees": (
        lambda c: c | {"goal_position": np.degrees(c["goal_position"])},
        "command unit",
        "commands are in degrees",
    ),
    "positions in degrees": (
        lambda c: c | {"present_position": np.degrees(c["present_position"])},
        "command unit",
        "positions are in degrees",
    ),
    "counts": (
        lambda c: c | {"goal_position": np.round(c["goal_position"] / (2 * np.pi) * 4096) + 2048},
        "command unit",
        "counts of an encoder",
    ),
    "both in degrees": (
        lambda c: c | {name: np.degrees(c[name]) for name in ("goal_position", "present_position")},
        "position unit",
        "positions look like degrees",
    ),
    "both in counts": (
        lambda c: (
            c
            | {
                name: np.round(c[name] / (2 * np.pi) * 4096)
                for name in ("goal_position", "present_position")
            }
        ),
        "position unit",
        "positions are counts of an encoder",
    ),
    "thinned": (_thin, "command rate", "change every 100 ms"),
    "no motion": (_stop, "no motion", "No joint moves"),
    "reversed": (
        lambda c: c | {"goal_position": -c["goal_position"]},
        "command order",
        "moves the other way",
    ),
    "with gaps": (_leave_gaps, "command rate", "change every 100 ms"),
    "positions copied": (
        lambda c: c | {"present_position": c["goal_position"]},
        "copied command",
        "equal the commands in every row",
    ),
    "command at rest": (
        lambda c: c | {"goal_position": np.full(len(c["t"]), 0.3)},
        "no command",
        "stand still while the arm moves",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_commands_that_contradict_positions_are_doubted(tmp_path: Path, mistake: str) -> None:
    spoil, kind, says = MISTAKES[mistake]
    folder = write_servo_set(tmp_path / "set", runs=2)
    for file in folder.glob("*.npz"):
        np.savez(file, **spoil(dict(np.load(file))))
    found = load_recordings(folder)
    doubts = list(doubt_commands(found, open_training_runs(found)))
    assert [doubt.kind for doubt in doubts] == [kind]
    assert says in doubts[0].evidence


@pytest.mark.parametrize("mistake", MISTAKES)
def test_doubts_end_with_exit_code_2(
    tmp_path: Path, mistake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil, _, says = MISTAKES[mistake]
    folder = write_servo_set(tmp_path / "set", runs=2)
    for file in folder.glob("*.npz"):
        np.savez(file, **spoil(dict(np.load(file))))
    assert run_command(["diagnose", str(folder), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_right_commands_raise_no_doubt(servo: RecordingSet) -> None:
    assert list(doubt_commands(servo, open_training_runs(servo))) == []


def test_a_limit_of_the_drive_is_named_and_simulated(tmp_path: Path) -> None:
    actuator = f"kp = [{KP}]\nkd = [0.0]\ntolerance = 0.01"
    folder = write_servo_set(tmp_path / "set", actuator=actuator, limit=1.6)
    state_drive(folder)
    found = diagnose(folder, experiment=False)
    (finding,) = found.findings
    assert finding.effect.name == "saturation"
    (limit,) = finding.parameters
    assert limit.sd is not None
    assert abs(limit.value - 1.6) < 2.0 * limit.sd < 0.16
    (run,) = found.positions
    before, after = (np.std(x - run.measured) for x in (run.before, run.after))
    assert after < 0.3 * before
    (said,) = (note for note in found.assumptions if "is taken from the recordings" in note)
    assert "saturation of joint 1" in said


@pytest.mark.parametrize(("kd", "missing"), [(0.2, 0.0), (0.1, 0.1)])
def test_an_error_of_a_gain_is_no_viscous_friction(
    tmp_path: Path, kd: float, missing: float
) -> None:
    # Gain and damping nearly cancel: 6 % of the gain are 30 % of the viscous friction.
    actuator = f"kp = [{KP / 1.06}]\nkd = [{kd}]\ntolerance = 0.03\ndelay = {DELAY}"
    folder = write_servo_set(tmp_path / "set", actuator=actuator)
    state_drive(folder)
    file = folder / "recordings.toml"
    file.write_text(file.read_text().replace(f"viscous = [{VISCOUS}]", "viscous = [0.05]"))
    found = diagnose(folder, experiment=False).findings
    assert [each.effect.name for each in found] == (["viscous"] if missing else [])
    for finding in found:
        assert abs(finding.parameters[0].value - missing) < 0.03


@pytest.mark.slow
def test_servo_from_a_plain_log_to_named_friction_and_a_rollout(tmp_path: Path) -> None:
    folder = write_servo_set(tmp_path / "log")
    (folder / "recordings.toml").unlink()
    logs = [str(file) for file in sorted(folder.glob("*.npz"))]
    own, out = tmp_path / "set", tmp_path / "out"
    urdf = str(folder / "robot.urdf")
    assert run_command(["init", "recording", *logs, "--urdf", urdf, "--out", str(own)]) == 0
    told = ["--no-experiment", "--quiet", "--no-report"]
    assert run_command(["diagnose", str(own), "--out", str(out), *told]) == 0
    answer = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    found = {each["effect"]: each["parameters"] for each in answer["findings"]}
    assert answer["verdict"] == "named"
    assert abs(found["coulomb"]["dFc"]["value"] - COULOMB) < 0.02
    (proof,) = answer["positions"]
    assert proof["rms_after"][0] < 2e-3 < 0.05 * proof["rms_before"][0]
    rolled = tmp_path / "rolled"
    model = str(out / "extended.toml")
    assert run_command(["rollout", str(own), "--model", model, "--out", str(rolled)]) == 0
    again = json.loads((rolled / "rollout.json").read_text(encoding="utf-8"))
    np.testing.assert_allclose(again["runs"][-1]["rms_after"], proof["rms_after"], rtol=1e-9)
    assert (rolled / "run2.png").exists()


def test_damaged_values_of_a_simulation_are_refused(servo: RecordingSet) -> None:
    own = resolve_actuator(servo, open_training_runs(servo))
    training = prepare_training(own.recordings, Settings(), None, lambda _: None, own.runs)
    section = model_section(own.recordings, fit_positions(own.recordings, own.runs[:1]))
    assert section is not None
    model = extended_model(own.recordings, training.constants, Extension())

    def read(values: dict[str, tuple[float, ...]]) -> ClosedLoopModel:
        changed = section.model_copy(update={"values": values})
        return read_model(own.recordings, replace(model, closed_loop=changed))

    whole = section.values
    np.testing.assert_array_equal(read(whole).fitted.of("coulomb"), whole["coulomb"])
    short = {name: own for name, own in whole.items() if name != "amplitudes"}
    for values, message in (
        (
            whole | {"coulomb": (np.nan,)},
            "coulomb has nan: finite numbers from 0 to inf are allowed",
        ),
        (
            whole | {"armature": (-0.1,)},
            "armature has -0.1: finite numbers from 0 to inf are allowed",
        ),
        (whole | {"zero": (np.inf,)}, "zero has inf: finite numbers from -inf to inf are allowed"),
        (whole | {"amplitudes": (0.3,)}, "amplitudes has 1 numbers, 0 needed"),
        (whole | {"dry": (0.1,)}, "dry has 1 numbers, no parameter has this name"),
        (short, "amplitudes is missing, 0 needed"),
    ):
        with pytest.raises(InputError, match=rf"closed_loop\.values\.{message}"):
            read(values)


def _case(name: str) -> Path:
    """Folder of a case beside the repository."""
    if not (CASES / name).is_dir():
        pytest.skip(f"{CASES / name} is absent")
    return CASES / name


@pytest.mark.slow
def test_a_servo_with_its_error_as_torque_has_its_values_named() -> None:
    """P gain 8.0 N m/rad; D .25 and viscous .06 N m s/rad, which no motion tells apart."""
    found = diagnose(_case("servo2"), experiment=False)
    named = {each.effect.name: each.parameters[0] for each in found.findings}
    true = {"coulomb": 0.10, "viscous": 0.25 + 0.06, "rotor_inertia": 0.012}
    assert set(named) == set(true)
    for name, value in true.items():
        sd = named[name].sd
        assert sd is not None
        assert abs(named[name].value - value) < 2.0 * sd < 0.2 * value
    loop = found.closed_loop
    assert loop is not None
    assert abs(loop.values["delay"][0] - 0.020) < 1e-3
    assert abs(loop.stiffness[0] * (1.0 + loop.values["gain"][0]) / 8.0 - 1.0) < 0.02


def test_goals_taken_as_positions_are_told_as_swapped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = _case("servo_goal"), tmp_path / "out"
    assert run_command(["diagnose", str(folder), "--out", str(out), "--quiet"]) == 2
    assert "position and command are swapped" in capsys.readouterr().err
    assert not out.exists()


def test_positions_alone_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = _case("notorque"), tmp_path / "out"
    assert run_command(["diagnose", str(folder), "--out", str(out), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "no joint has a torque or a command" in said
    assert "those of commanded positions as command" in said
    assert not out.exists()


@pytest.mark.slow
def test_real_leg_is_simulated_from_commands_within_4_mrad(tmp_path: Path) -> None:
    found = diagnose(
        _write_leg(tmp_path, "kp = [20.0, 20.0, 20.0]\nkd = [1.5, 1.5, 1.5]"), experiment=False
    )
    (run,) = found.positions
    error = float(np.sqrt(np.mean((run.after - run.measured) ** 2)))
    assert error < 4e-3
    assert "position_friction" in {each.effect.name for each in found.findings}
    assert found.closed_loop is not None
    np.testing.assert_allclose(found.closed_loop.values["coulomb"][2], 0.9, atol=0.3)


@pytest.fixture(scope="module")
def leg_without_gains(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    return diagnose(_write_leg(tmp_path_factory.mktemp("leg"), ""), experiment=False)


@pytest.mark.slow
def test_gains_of_a_real_leg_are_told_by_its_weight_or_said_not_to_be(
    leg_without_gains: Diagnosis,
) -> None:
    loop = leg_without_gains.closed_loop
    assert loop is not None
    # The calf weighs too little: of it ratios to the gain are told alone.
    assert np.isnan(loop.ratios["coulomb"]).tolist() == [True, True, False]
    assert loop.ratios["coulomb"][2] > 0.0
    (run,) = leg_without_gains.positions
    assert float(np.sqrt(np.mean((run.after - run.measured) ** 2))) < 4e-3


@pytest.mark.slow
def test_gains_of_a_real_leg_are_those_that_its_manufacturer_states(
    leg_without_gains: Diagnosis,
) -> None:
    """It states 20 N m/rad."""
    loop = leg_without_gains.closed_loop
    assert loop is not None
    gain = np.array(loop.stiffness) * (1.0 + np.array(loop.values["gain"]))
    spread = np.array(loop.stiffness) * np.array(loop.deviations["gain"])
    told = np.isnan(loop.ratios["coulomb"])
    assert (np.abs(gain - 20.0) < 2.0 * spread)[told].all(), (gain, spread)


def _write_leg(tmp_path: Path, actuator: str) -> Path:
    """Write the set of a real leg with some lines of its actuators."""
    if not GO2.is_dir():
        pytest.skip(f"{GO2} is absent")
    for name in ("train.csv", "test.csv", "leg.urdf"):
        (tmp_path / name).write_bytes((GO2 / name).read_bytes())
    joints = ("hip", "thigh", "calf")
    listed = {k: ", ".join(f'"{k}_{j}"' for j in joints) for k in ("command", "position")}
    (tmp_path / "recordings.toml").write_text(
        f"""schema = 1
name = "leg"
robot = "leg.urdf"
joints = ["hip", "thigh", "calf"]
[signals]
time = "time"
position = [{listed["position"]}]
command = [{listed["command"]}]
[actuator]
kind = "position_servo"
{actuator}
[[runs]]
file = "train.csv"
role = "train"
[[runs]]
file = "test.csv"
role = "test"
""",
        encoding="utf-8",
    )
    return tmp_path


def test_commands_of_an_experiment_move_the_arm_along_it(tmp_path: Path) -> None:
    actuator = f"kp = [{KP}]\nkd = [0.0]\ndelay = {DELAY}"
    folder = write_servo_set(tmp_path / "set", actuator=actuator, runs=2)
    state_drive(folder)
    found = load_recordings(folder)
    runs = open_training_runs(found)
    knots = np.linspace(0.0, 4.0, 9)
    rate = np.array([0.0, 6.0, -9.0, 4.0, -1.0, 5.0, -6.0, 1.0, 0.0])
    start = np.array([-0.2])
    motion = Trajectory.piecewise_linear_acceleration(knots, rate[:, None], start, np.zeros(1))
    sent = motion_commands(RobotModel(found), runs, motion)
    assert sent is not None
    np.testing.assert_allclose(np.diff(sent.time), 0.02)
    wanted = motion(sent.time)
    own = CommandedRun("experiment", sent.time, sent.position, wanted, motion(sent.time, 1))
    loop = build_loop(found, [own], found.robot.tree)
    reached = simulate(loop, own, nominal_parameters(found, found.robot))
    assert np.ptp(wanted) > 0.5
    assert np.abs(reached - wanted).max() < 0.02 < 0.1 * np.abs(sent.position - wanted).max()
