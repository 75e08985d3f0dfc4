"""The way of a new user by commands: own URDF to a solved motion, own table to a diagnosis."""

from __future__ import annotations

import json
import shutil
import tomllib

import numpy as np
import pytest
from gripper_arm import write_gripper_urdf
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.problem.files import load_problem
from stiffopt.problem.resolve import resolve
from stiffopt.robot.files import load_robot

SHIPPED = ROOT / "problems" / "recordings" / "two_link_friction"
HEAD = ["Zeit [ms]", "Achse_1_Position [deg]", "Achse_2_Position [deg]", "Drehmoment_1 [Nm]",
        "Drehmoment_2 [Nm]"]  # fmt: skip


def german_tables(folder) -> None:
    """The shipped runs as a controller with decimal commas logs them, in degrees and ms."""
    folder.mkdir()
    for file in sorted(SHIPPED.glob("*.npz")):
        with np.load(file) as stored:
            columns = [1e3 * stored["t"], *(np.degrees(stored[q]) for q in ("q1", "q2"))]
            columns += [stored["tau1"], stored["tau2"]]
        lines = ["# controller X", ";".join(HEAD)]
        for row in np.column_stack(columns):
            lines.append(";".join(f"{value:.9g}".replace(".", ",") for value in row))
        name = file.stem.replace("test_1", "z_test") + ".csv"
        (folder / name).write_text("\n".join(lines), encoding="utf-8-sig")


def test_a_robot_file_of_a_urdf_is_read_as_it_is(tmp_path, capsys):
    urdf = write_gripper_urdf(tmp_path)
    assert run(["init", "robot", str(urdf), "--tip", "hand"]) == 0
    path = tmp_path / "seven_robot.toml"
    arm, bare = load_robot(path), load_robot(urdf)
    assert arm.joint_names == bare.joint_names == tuple(f"axis_{k}" for k in range(1, 8))
    assert arm.torque_max == pytest.approx(bare.torque_max)
    assert arm.tool.link == "hand"
    assert all(chain is not None for chain in arm.chains)
    assert len(arm.estimated()) > 7
    document = tomllib.loads(path.read_text())
    assert document["lock"] == {"finger_1": 0.0, "finger_2": 0.0}
    capsys.readouterr()
    assert run(["init", "robot", str(urdf)]) == 2
    assert "exists and is kept" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("arm.sdf", "<sdf/>", "is an SDF; URDF and MJCF are read. Take the URDF"),
        ("arm.urdf", "<sdf/>", "is an SDF (a model of Gazebo); URDF and MJCF are read"),
        ("arm.urdf.xacro", "<robot/>", "expand its xacro: `xacro arm.urdf.xacro > arm.urdf`"),
        ("arm.toml", "schema = 1", "is a robot file already: continue with `stiffopt init problem"),
    ],
)
def test_other_formats_than_urdf_are_refused(name, text, said, tmp_path, capsys):
    (tmp_path / name).write_text(text)
    assert run(["init", "robot", str(tmp_path / name)]) == 2
    assert said in capsys.readouterr().err


def test_reducer_carries_the_torque():
    from stiffopt.starter.robot_file import reducers_for

    assert reducers_for(87.0)[0][0] == "harmonic_25_80"
    assert all(peak >= 87.0 for _, peak in reducers_for(87.0))
    assert reducers_for(2e4) == []
    assert reducers_for(3000.0)[0][0] == "rv_160e_171"


@pytest.mark.parametrize("source", ["er3a_c60", "ur10", "two_link"])
def test_first_problem_is_feasible(source, tmp_path):
    robot = str(ROOT / "problems" / "two_link_robot.toml") if source == "two_link" else source
    path = tmp_path / "first.toml"
    assert run(["init", "problem", robot, "--out", str(path)]) == 0
    problem = load_problem(path).problem
    motion = resolve(problem)
    assert np.abs(motion.end - motion.start).min() > 0.0


def test_a_flange_without_a_urdf(tmp_path, capsys):
    out = tmp_path / "flange"
    options = ["--torque", "80 N*m", "--size", "M6", "--count", "6", "--circle", "60 mm"]
    assert run(["init", "flange", "--out", str(out), *options]) == 0
    result = tmp_path / "result"
    assert run(["preload", str(out / "flange.toml"), "--out", str(result), "--quiet"]) == 0
    study = json.loads((result / "study.json").read_text())
    assert study["status"] == "optimal"
    assert run(["init", "flange", "--out", str(tmp_path / "x"), "--size", "M7"]) == 2
    assert "no bolt 'M7'" in capsys.readouterr().err


def test_table_to_a_checked_recording_set(tmp_path, capsys):
    german_tables(tmp_path / "data")
    folder = tmp_path / "set"
    arguments = ["init", "recording", str(tmp_path / "data"), "--urdf", str(SHIPPED / "robot.urdf")]
    assert run([*arguments, "--out", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "in deg by" in said
    document = tomllib.loads((folder / "recordings.toml").read_text())
    assert document["signals"]["scale"] == {"time": "ms", "position": "deg"}
    assert document["signals"]["position"] == HEAD[1:3]
    assert [each["role"] for each in document["runs"]] == ["train"] * 3 + ["test"]
    assert run(["recording", "check", str(folder)]) == 0
    assert run([*arguments, "--out", str(folder)]) == 2


def test_table_of_an_arm_with_an_incomplete_urdf(tmp_path, capsys):
    """As URDFs of industrial arms: no torque limits, a link without mass; guessed and said."""
    german_tables(tmp_path / "data")
    urdf = tmp_path / "arm.urdf"
    text = (SHIPPED / "robot.urdf").read_text().replace('effort="150"', 'effort="0"')
    urdf.write_text(text.replace(' velocity="4.2"/>', ' velocity="4.2"/><dynamics friction="9"/>'))
    arguments = ["init", "recording", str(tmp_path / "data"), "--urdf", str(urdf)]
    folder = tmp_path / "set"
    assert run([*arguments, "--out", str(folder)]) == 0
    assert "GUESSED: the URDF has no effort for joint1." in capsys.readouterr().out
    arm = load_robot(folder / "robot.toml")
    # What recordings are to tell is not guessed.
    assert all(chain is None for chain in arm.chains)
    assert not arm.coulomb.any()
    assert run(["recording", "check", str(folder)]) == 0
    assert "Coulomb friction is not known" in capsys.readouterr().out


def test_own_table_beside_a_robot_file(tmp_path, capsys):
    german_tables(tmp_path / "data")
    (tmp_path / "arm").mkdir()
    shutil.copyfile(SHIPPED / "robot.urdf", tmp_path / "arm" / "arm.urdf")
    file = str(tmp_path / "arm" / "robot.toml")
    assert run(["init", "robot", str(tmp_path / "arm" / "arm.urdf"), "--out", file]) == 0
    folder = tmp_path / "set"
    arguments = ["init", "recording", str(tmp_path / "data"), "--urdf", file, "--out", str(folder)]
    assert run(arguments) == 0
    shutil.rmtree(tmp_path / "arm")
    capsys.readouterr()
    assert run(["recording", "check", str(folder)]) == 0
    assert "drivetrains are those of the robot's file" in capsys.readouterr().out
    assert run([*arguments, "--tip", "link2"]) == 2


@pytest.mark.slow
def test_own_table_to_a_diagnosis(tmp_path):
    """Three commands; the truth is 2.32 N m at joint 2."""
    german_tables(tmp_path / "data")
    folder, out = tmp_path / "set", tmp_path / "out"
    urdf = str(SHIPPED / "robot.urdf")
    arguments = [str(tmp_path / "data"), "--urdf", urdf, "--out", str(folder)]
    assert run(["init", "recording", *arguments]) == 0
    assert run(["recording", "check", str(folder)]) == 0
    assert run(["diagnose", str(folder), "--out", str(out), "--quiet", "--no-report"]) == 0
    document = json.loads((out / "diagnosis.json").read_text())
    (own,) = [f for f in document["findings"] if (f["effect"], f["joint"]) == ("coulomb", 2)]
    assert own["parameters"]["dFc"]["value"] == pytest.approx(2.32, abs=0.06)
    predicted, recorded = np.load(out / "pred_after_z_test.npz"), np.load(folder / "z_test.npz")
    for name in (HEAD[0], HEAD[4]):
        assert predicted[name] == pytest.approx(recorded[name], abs=2.5)


@pytest.mark.slow
def test_own_urdf_to_an_exported_motion(tmp_path):
    """Four commands."""
    urdf = write_gripper_urdf(tmp_path)
    robot, problem, out = (tmp_path / n for n in ("seven_robot.toml", "seven_first.toml", "out"))
    assert run(["init", "robot", str(urdf), "--tip", "hand"]) == 0
    assert run(["init", "problem", str(robot)]) == 0
    assert run(["solve", str(problem), "--out", str(out), "--quiet"]) == 0
    result = json.loads((out / "result.json").read_text())
    assert result["status"] == "optimal"
    assert result["certificate"]["worst_violation"]["value"] <= 0.005
    assert run(["export", str(out), "--to", "csv", "--rate", "100"]) == 0


def test_one_recording_is_cut_in_two(tmp_path, capsys):
    with np.load(SHIPPED / "train_1.npz") as stored:
        columns = {name: stored[name] for name in stored.files}
    np.savez(tmp_path / "one.npz", **columns)
    arguments = ["init", "recording", str(tmp_path / "one.npz"), "--urdf"]
    assert run([*arguments, str(SHIPPED / "robot.urdf")]) == 0
    assert "first 70 %" in capsys.readouterr().out
    text = (tmp_path / "one_set" / "recordings.toml").read_text()
    assert 'link_position = ["ql1", "ql2"]' in text
    assert 'velocity = ["qd1", "qd2"]' in text
    shutil.rmtree(tmp_path / "one_set")


@pytest.mark.parametrize(
    ("head", "units"),
    [
        ("timestamp,actual_q_0,actual_q_1,target_q_0,target_q_1,actual_current_0,actual_current_1",
         {"torque": "A"}),
        ("t joint1/position joint2/position joint1/effort joint2/effort", {}),
        ("time_s\tq1_deg\tq2_deg\ttau1\ttau2", {"position": "deg"}),
    ],
)  # fmt: skip
def test_columns_by_the_names_of_common_loggers(head, units, tmp_path):
    from stiffopt.recording.readers.read import read_tables
    from stiffopt.starter.guessing import guess_columns

    mark = "," if "," in head else "\t" if "\t" in head else " "
    t = np.arange(0.0, 5.0, 0.01)
    names = head.split(mark)
    scale = 57.3 if "position" in units else 1.0
    rows = [t] + [scale * np.sin((k + 1) * t) for k in range(len(names) - 1)]
    lines = [head, *(mark.join(f"{v:.6f}" for v in row) for row in np.column_stack(rows))]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    found = guess_columns(read_tables(tmp_path / "log.csv")[""], load_robot(SHIPPED / "robot.urdf"))
    assert {kind: unit for kind, unit in found.units.items() if unit} == units
    assert "target" not in " ".join(found.columns["position"])
    assert len(found.columns["torque"]) == 2


def test_a_table_without_torques_is_told_what_is_missing(tmp_path, capsys):
    (tmp_path / "log.csv").write_text("t,q1,q2\n0,1,2\n0.1,1,2\n0.2,1,3\n")
    urdf = str(SHIPPED / "robot.urdf")
    assert run(["init", "recording", str(tmp_path / "log.csv"), "--urdf", urdf]) == 2
    assert "no torque was recognised for 2 joints" in capsys.readouterr().err


def test_catalogue_and_explain(capsys):
    assert run(["catalogue"]) == 0
    for kind, entry in (("reducers", "harmonic_25_100"), ("bolts", "M24"), ("keys", "5x5"),
                        ("belts", "HTD3M"), ("surfaces", "fine_steel"), ("robots", "ur10"),
                        ("effects", "belt_creep")):  # fmt: skip
        capsys.readouterr()
        assert run(["catalogue", kind]) == 0
        assert entry in capsys.readouterr().out
    assert run(["explain", "motion.duration"]) == 0
    said = capsys.readouterr().out
    assert "motion.duration (trajectory)" in said
    assert "optimised between two bounds" in said
    assert run(["explain", "lock"]) == 0
    assert "Joints that are held" in capsys.readouterr().out
    assert run(["explain", "prepresure"]) == 2
    assert "Did you mean 'prepressure'?" in capsys.readouterr().err
