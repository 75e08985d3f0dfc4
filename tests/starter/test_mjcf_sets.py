"""Recording sets of arms that an MJCF describes."""

from __future__ import annotations

import numpy as np
import pytest
from mjcf_models import write_arm, write_legs

from stiffopt.cli import run
from stiffopt.recording.recording_set import load_recordings
from stiffopt.starter.recorded_robot import store_robot

pytest.importorskip("mujoco")


def write_log(path, joints, seconds=8.0):
    """Write positions and torques of joints, at 100 Hz, as CSV."""
    time = np.arange(0.0, seconds, 0.01)
    waves = [np.sin((1.0 + 0.2 * k) * time) for k in range(2 * len(joints))]
    names = [f"{kind}_{name}" for kind in ("q", "tau") for name in joints]
    table = np.column_stack([time, *waves])
    np.savetxt(path, table, delimiter=",", header=",".join(["time", *names]), comments="")
    return path


def start_set(tmp_path, model, joints, *more):
    log = write_log(tmp_path / "log.csv", joints)
    arguments = [
        "init",
        "recording",
        str(log),
        "--urdf",
        str(model),
        "--out",
        str(tmp_path / "set"),
    ]
    assert run([*arguments, *more]) == 0
    return load_recordings(tmp_path / "set")


def test_joint_values_and_springs_are_nominal_with_a_tolerance(tmp_path, capsys):
    model = write_arm(tmp_path)
    own = start_set(tmp_path, model, ("pan", "lift", "slide", "roll"))
    model.unlink()
    again = load_recordings(tmp_path / "set")
    assert again.robot.rotor_inertia == pytest.approx([0.3, 0.1, 0.3, 0.3])
    assert again.robot.coulomb == pytest.approx([1.5, 0.4, 1.5, 1.5])
    assert (own.tolerance.coulomb, own.tolerance.rotor_inertia) == (0.05, 0.05)
    assert own.tolerance.mass is None
    (spring,) = own.nominal.counterbalance
    assert (spring.joint, spring.stiffness, spring.offset) == (2, 40.0, 0.1)
    assert (tmp_path / "set" / "parts" / "defaults.xml").is_file()
    assert "GUESSED: the MJCF has no velocity" in capsys.readouterr().out


def test_both_legs_of_a_free_trunk_are_an_arm_on_a_fixed_base(tmp_path, capsys):
    joints = [f"{part}_{side}" for side in "lr" for part in ("hip", "thigh", "calf")]
    own = start_set(tmp_path, write_legs(tmp_path), joints)
    assert set(own.joints) == set(joints)
    assert "Held at 0 (free in the model): floating." in capsys.readouterr().out


def test_one_leg_is_named_by_its_tip(tmp_path):
    own = start_set(
        tmp_path, write_legs(tmp_path), ("hip_r", "thigh_r", "calf_r"), "--tip", "calf_r"
    )
    assert own.joints == ("hip_r", "thigh_r", "calf_r")


def test_servo_gains_stand_behind_comment_marks(tmp_path):
    model = write_legs(tmp_path)
    servos = "".join(
        f'<position joint="{part}_l" kp="{kp}" kv="0.5" gear="2"/>'
        for part, kp in (("hip", 5), ("thigh", 6), ("calf", 7))
    )
    text = model.read_text().replace("</mujoco>", f"<actuator>{servos}</actuator></mujoco>")
    model.write_text(text)
    start_set(tmp_path, model, ("hip_l", "thigh_l", "calf_l"), "--tip", "calf_l")
    written = (tmp_path / "set" / "recordings.toml").read_text()
    assert "# kp = [20.0, 24.0, 28.0]\n# kd = [2.0, 2.0, 2.0]\n" in written


def test_servos_of_an_mjcf_are_the_only_gains_of_a_commanded_set(tmp_path):
    model, joints = write_legs(tmp_path), ("hip_l", "thigh_l", "calf_l")
    servos = "".join(f'<position joint="{name}" kp="5"/>' for name in joints)
    text = model.read_text().replace("</mujoco>", f"<actuator>{servos}</actuator></mujoco>")
    model.write_text(text)
    log, time = tmp_path / "log.csv", np.arange(0.0, 8.0, 0.01)
    angles = 0.5 * np.sin(np.outer(time, (1.0, 1.3, 1.7)))
    names = [f"{kind}[{name}]" for kind in ("ctrl", "qpos") for name in joints]
    header = ",".join(["time", *names])
    columns = np.column_stack([time, angles, 0.95 * angles])
    np.savetxt(log, columns, delimiter=",", header=header, comments="")
    own = ["init", "recording", str(log), "--urdf", str(model), "--tip", "calf_l"]
    assert run([*own, "--out", str(tmp_path / "set")]) == 0
    written = (tmp_path / "set" / "recordings.toml").read_text()
    assert written.count("# [actuator]") == 1
    assert "# kd = [0.0, 0.0, 0.0]\n" in written
    # Torque limits that the robot file guesses bound no drive; stated ones do.
    law, robot = load_recordings(tmp_path / "set").actuator, tmp_path / "set" / "robot.toml"
    assert np.isinf(law.torque_max).all()
    robot.write_text(robot.read_text().replace('estimated = ["torque_max"]\n', ""))
    assert np.isfinite(load_recordings(tmp_path / "set").actuator.torque_max).all()


def test_commanded_joints_at_rest_are_no_table_of_poses(tmp_path, capsys):
    """Poses at rest need torques: these are refused as a recording without motion."""
    model, names = write_arm(tmp_path), ("pan", "lift", "slide", "roll")
    time, log = np.arange(0.0, 8.0, 0.01), tmp_path / "log.csv"
    noise = 1e-5 * np.random.default_rng(0).normal(size=(len(time), 4))
    header = ",".join(["time", *[f"{kind}[{name}]" for kind in ("ctrl", "qpos") for name in names]])
    columns = np.column_stack([time, np.full_like(noise, 0.3), 0.3 + noise])
    np.savetxt(log, columns, delimiter=",", header=header, comments="")
    own, folder = ["init", "recording", str(log), "--urdf", str(model)], tmp_path / "set"
    assert run([*own, "--out", str(folder)]) == 0
    assert "at_rest" not in (folder / "recordings.toml").read_text()
    assert run(["diagnose", str(folder), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert "No joint moves" in capsys.readouterr().err


def test_a_set_names_an_mjcf_itself(tmp_path):
    """Limits that MuJoCo does not state do not exist."""
    start_set(tmp_path, write_arm(tmp_path), ("pan", "lift", "slide", "roll"))
    file = tmp_path / "set" / "recordings.toml"
    file.write_text(file.read_text().replace('"robot.toml"', '"arm/odd.xml"'))
    robot = load_recordings(tmp_path / "set").robot
    assert robot.coulomb == pytest.approx([1.5, 0.4, 1.5, 1.5])
    assert list(robot.torque_max) == [60.0, 40.0, np.inf, np.inf]
    assert (robot.velocity_max == np.inf).all()
    # As the set's tool_frame says.
    assert robot.tool.link == "hand"


def test_log_of_one_leg_asks_for_its_tip(tmp_path, capsys):
    log = write_log(tmp_path / "log.csv", ("hip_r", "thigh_r", "calf_r"))
    arguments = ["init", "recording", str(log), "--urdf", str(write_legs(tmp_path))]
    assert run([*arguments, "--out", str(tmp_path / "set")]) == 2
    said = capsys.readouterr().err
    assert "no position was recognised for 6 joints" in said
    assert '--tip "calf_l" or --tip "calf_r"' in said


def test_values_are_looser_without_torques(tmp_path):
    (tmp_path / "set").mkdir()
    robot = store_robot(write_arm(tmp_path), tmp_path / "set")
    assert "coulomb = 0.05" in robot.entries(torque=True)
    assert "coulomb = 0.3" in robot.entries(torque=False)
