"""Recordings that contradict their own description are stopped, with the line that mends them."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from shipped_set import SHIPPED
from simulated_sets import simulated
from small_arms import ROOT

from benchmarks.real_concealed.hide import KINDS, hidden
from benchmarks.real_concealed.motion import PublicSet
from benchmarks.simulator import CaseSpec, motion, simulate, write_case
from stiffopt.cli import run
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.sanity.doubt import Doubt, DoubtfulRecordings
from stiffopt.discovery.sanity.explanations import Explanations
from stiffopt.discovery.sanity.gate import SanityGate, _is_effect_of_all_runs
from stiffopt.discovery.sanity.interpretations import Reading, sample_runs
from stiffopt.discovery.sanity.sensor_doubts import doubt_second_sensors
from stiffopt.discovery.training import open_training_runs
from stiffopt.recording.recording_set import load_recordings
from stiffopt.recording.run import Fault
from stiffopt.recording.signals import is_set_point

PUBLISHED = ROOT.parent / "shared" / "recordings"
OPEN_CASES = ROOT.parent / "shared" / "blind" / "open"

Columns = dict[str, np.ndarray]
DEGREES = 180.0 / np.pi


def changed_copy(source: Path, folder: Path, change: Callable[[Columns], None]) -> Path:
    """The set with the columns of all its runs changed."""
    shutil.copytree(source, folder)
    for file in folder.glob("*.npz"):
        with np.load(file) as stored:
            columns = dict(stored)
        change(columns)
        np.savez_compressed(file, **columns)
    return folder


def rewritten(folder: Path, old: str, new: str) -> None:
    file = folder / "recordings.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def doubted(folder: Path) -> tuple[Doubt, ...]:
    recordings = load_recordings(folder)
    return SanityGate(recordings, open_training_runs(recordings)).doubts


def times(names: str, factor: float) -> Callable[[Columns], None]:
    def change(columns: Columns) -> None:
        for name in names.split():
            columns[name] = columns[name] * factor

    return change


def exchanged(*pairs: tuple[str, str]) -> Callable[[Columns], None]:
    def change(columns: Columns) -> None:
        for one, two in pairs:
            columns[one], columns[two] = columns[two], columns[one]

    return change


def late(columns: Columns) -> None:
    for name in ("tau1", "tau2"):
        columns[name] = np.interp(columns["t"] - 0.15, columns["t"], columns[name])


ANGLES = "q1 q2 ql1 ql2 qd1 qd2"
SCALE = "[signals.scale]\n"
# What is done to the columns, what is doubted of which joints, what mends it.
CASES = {
    "degrees": (
        times(ANGLES, DEGREES),
        ("position unit", (1, 2)),
        SCALE + 'position = "deg"\nvelocity = "deg/s"\nlink_position = "deg"\n',
    ),
    "mN m": (
        times("tau1 tau2", 1e3),
        ("torque unit", (1,)),
        SCALE + "torque = [0.001, 0.001]\n",
    ),
    "amperes": (
        times("tau1 tau2", 1.0 / 13.9),
        ("torque unit", (1,)),
        SCALE + "torque = [13.8, 13.7]\n",
    ),
    "a turned sign": (
        times("tau2", -1.0),
        ("torque sign", (2,)),
        SCALE + "torque = [1.0, -1.0]\n",
    ),
    "an axis turned round": (
        times("tau2 q2 ql2 qd2", -1.0),
        ("position sign", (2,)),
        SCALE + "torque = [1.0, -1.0]\nposition = [1.0, -1.0]\nvelocity = [1, -1]\n"
        "link_position = [1, -1]\n",
    ),
    "a gain": (times("tau1", 20.0), ("torque gain", (1,)), SCALE + "torque = [0.0497, 1.0]\n"),
    "torque before the gear": (
        lambda columns: columns.update(tau1=columns["tau1"] / 101.0, tau2=columns["tau2"] / 81.0),
        ("torque unit", (1,)),
        SCALE + "torque = [101.0, 81.0]\n",
    ),
    "velocity in degrees": (
        times("qd1 qd2", DEGREES),
        ("velocity", (1, 2)),
        SCALE + 'velocity = "deg/s"\n',
    ),
    "velocity in turns a minute": (
        times("qd1 qd2", 30.0 / np.pi),
        ("velocity", (1, 2)),
        SCALE + 'velocity = "rpm"\n',
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_contradiction_stops_and_line_corrects_it(case: str, tmp_path: Path) -> None:
    change, (kind, joints), mended = CASES[case]
    folder = changed_copy(SHIPPED, tmp_path / "set", change)
    found = doubted(folder)
    assert (found[0].kind, found[0].joints) == (kind, joints)
    assert all(line.split(" = ")[0] in found[0].line for line in mended.splitlines()[1:2])
    if "[1.0, -1.0]" not in mended and '"' not in mended:
        assert mended.splitlines()[1] in found[0].line
    rewritten(folder, "[nominal]\n", f"{mended}\n[nominal]\n")
    assert doubted(folder) == ()


def test_exchanged_torque_columns(tmp_path: Path) -> None:
    folder = changed_copy(SHIPPED, tmp_path / "set", exchanged(("tau1", "tau2")))
    (found,) = doubted(folder)
    assert (found.kind, found.joints) == ("torque order", (1, 2))
    assert found.line == 'torque = ["tau2", "tau1"] in [signals]'
    rewritten(folder, 'torque = ["tau1", "tau2"]', 'torque = ["tau2", "tau1"]')
    assert doubted(folder) == ()


def test_exchanged_joints(tmp_path: Path) -> None:
    pairs = [(f"{kind}1", f"{kind}2") for kind in ("q", "qd", "ql", "tau")]
    folder = changed_copy(SHIPPED, tmp_path / "set", exchanged(*pairs))
    found = doubted(folder)
    assert (found[0].kind, found[0].joints) == ("joint order", (1, 2))
    assert 'position = ["q2", "q1"] and torque = ["tau2", "tau1"]' in found[0].line


@pytest.mark.parametrize("stated", ["[0.0, 0.0, 9.81]", "[9.81, 0.0, 0.0]"])
def test_gravity_upside_down_or_aside(stated: str, tmp_path: Path) -> None:
    folder = changed_copy(SHIPPED, tmp_path / "set", lambda columns: None)
    rewritten(folder, "[0.0, 0.0, -9.81]", stated)
    (found,) = doubted(folder)
    assert found.kind == "gravity"
    assert found.line == "gravity = [0.0, 0.0, -9.81]"


def test_a_current_that_fits_every_factor_has_no_unit(tmp_path: Path) -> None:
    """Friction of a joint without weight may have any size: 1 A may be 10 N m or 1000."""

    def current(columns: Columns) -> None:
        angles = np.column_stack([columns["q1"], columns["q2"]])
        weight = robot.gravity_torque(angles, recordings.gravity)[:, 1]
        friction = 300.0 * np.tanh(columns["qd2"] / 0.02)
        columns["tau2"] = (columns["tau2"] - weight + friction) / 100.0

    recordings = load_recordings(SHIPPED)
    robot = RobotModel(recordings)
    folder = changed_copy(SHIPPED, tmp_path / "set", current)
    file = folder / "recordings.toml"
    text = re.sub(r"(?m)^(coulomb|viscous) = .*\n", "", file.read_text())
    file.write_text(text + '\n[signals.scale]\ntorque = [1.0, "A"]\n')
    assert doubted(folder) == ()


def test_late_torques(tmp_path: Path) -> None:
    folder = changed_copy(SHIPPED, tmp_path / "set", late)
    (found,) = doubted(folder)
    assert found.kind == "delay"
    delay = float(found.line.split()[2])
    assert delay == pytest.approx(0.15, abs=0.01)
    rewritten(folder, "[nominal]\n", "\n[nominal]\n")
    rewritten(folder, "[signals]\n", "[signals]\ntorque_delay = 0.15\n")
    assert doubted(folder) == ()


def test_positions_beyond_the_limits(tmp_path: Path) -> None:
    folder = changed_copy(SHIPPED, tmp_path / "set", lambda columns: None)
    urdf = folder / "robot.urdf"
    recordings = load_recordings(folder)
    lower = recordings.robot.position_lower[0]
    text = urdf.read_text()
    assert f'lower="{lower:g}"' in text
    urdf.write_text(text.replace(f'lower="{lower:g}"', 'lower="0.3"'))
    (found,) = doubted(folder)
    assert found.kind == "position limits"
    assert 1 in found.joints
    assert "its limits are 0.3 to" in found.evidence


def test_doubtful_recordings_give_no_result(tmp_path: Path, capsys) -> None:
    folder = changed_copy(SHIPPED, tmp_path / "set", times(ANGLES, DEGREES))
    assert run(["diagnose", str(folder), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert not (tmp_path / "out").exists()
    said = capsys.readouterr().err
    assert "look like degrees" in said
    assert 'position = "deg"' in said
    assert "--despite-doubts" in said
    assert run(["recording", "check", str(folder)]) == 2
    assert "look like degrees" in capsys.readouterr().err


def test_despite_doubts_reports_doubt(tmp_path: Path) -> None:
    folder = changed_copy(SHIPPED, tmp_path / "set", times("tau2", -1.0))
    with pytest.raises(DoubtfulRecordings, match="has the other sign"):
        diagnose(folder)
    out = tmp_path / "out"
    options = ["--no-report", "--no-experiment", "--quiet", "--despite-doubts"]
    assert run(["diagnose", str(folder), "--out", str(out), *options]) == 0
    document = json.loads((out / "diagnosis.json").read_text())
    assert [doubt["kind"] for doubt in document["doubts"]] == ["torque sign"]
    assert document["assumptions"][0].startswith("Diagnosed despite a doubt: The torque of joint 2")
    assert document["verdict"] != "named"


def test_the_shipped_set_passes() -> None:
    assert doubted(SHIPPED) == ()


@pytest.mark.parametrize(
    "effect",
    [
        ("torque_gain", 2, 4.0),
        ("gravity_spring", 2, 4.0),
        ("payload", None, 4.0),
        ("time_delay", None, 4.0),
        ("coulomb", 1, 4.0),
    ],
)
def test_catalogue_effects_raise_no_doubt(effect, tmp_path: Path) -> None:
    spec = CaseSpec(effects=(effect,), seed=8, train=2, test=1, extrapolate=0, seconds=3.0,
                    rate=250.0, substeps=8)  # fmt: skip
    folder = write_case(simulated(spec), tmp_path / "set")
    assert doubted(folder) == ()


@pytest.mark.slow
@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="the recordings lie beside the package")
def test_public_recordings_pass() -> None:
    folders = [*PUBLISHED.iterdir(), *(OPEN_CASES.iterdir() if OPEN_CASES.is_dir() else ())]
    stopped = {
        folder.name: [str(doubt) for doubt in found]
        for folder in folders
        if (folder / "recordings.toml").is_file() and (found := doubted(folder))
    }
    assert stopped == {}


@pytest.mark.slow
@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="the recordings lie beside the package")
@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (times("q1 q2 q3 q4 q5 q6 qd1 qd2 qd3 qd4 qd5 qd6", DEGREES), "position unit"),
        (times("tau1 tau2 tau3 tau4 tau5 tau6", 1.0 / 13.9), "torque unit"),
        (times("tau1 tau2 tau3 tau4 tau5 tau6", 1e3), "torque unit"),
        (times("tau2", -1.0), "torque sign"),
        (exchanged(("tau2", "tau3")), "torque order"),
        (exchanged(("q2", "q3"), ("qd2", "qd3"), ("tau2", "tau3")), "joint order"),
    ],
)
def test_a_real_arm_with_six_joints(change, kind: str, tmp_path: Path) -> None:
    folder = changed_copy(PUBLISHED / "unisa_ur10", tmp_path / "set", change)
    assert doubted(folder)[0].kind == kind


def test_robot_without_masses_is_doubted(tmp_path):
    folder = changed_copy(SHIPPED, tmp_path / "set", lambda columns: None)
    urdf = folder / "robot.urdf"
    urdf.write_text(re.sub(r"<inertial>.*?</inertial>", "", urdf.read_text(), flags=re.DOTALL))
    [doubt] = doubted(folder)
    assert doubt.kind == "masses"
    assert "has no <inertial>" in str(doubt)


@pytest.mark.slow
@pytest.mark.skipif(not (PUBLISHED / "tx40_first").exists(), reason="no public recordings here")
def test_torque_ripple_is_no_doubt_about_degrees(tmp_path):
    """Degrees would let the joint stand still nearly all along: little is left to explain then."""
    source = PublicSet(PUBLISHED / "tx40_first")
    ripple = next(kind for kind in KINDS if kind.name == "ripple")
    hidden(source, ripple, 3, 8.0, tmp_path / "set")
    assert doubted(tmp_path / "set") == ()


def test_one_joint_in_rad_where_all_are_stated_in_degrees(tmp_path):
    """Joint 2 was logged by another device: as degrees it would stand still."""
    folder = changed_copy(SHIPPED, tmp_path / "set", times("q1 ql1 qd1", DEGREES))
    stated = SCALE + 'position = "deg"\nvelocity = "deg/s"\nlink_position = "deg"\n'
    rewritten(folder, "\n[nominal]\n", f"\n{stated}\n[nominal]\n")
    found = [d for d in doubted(folder) if d.kind == "position unit"]
    assert [doubt.joints for doubt in found] == [(2,)]
    assert "rad, not degrees" in found[0].evidence
    assert found[0].line.startswith("position = [0.0174533, 1.0] in [signals.scale]")


def test_a_joint_that_travels_as_far_as_the_others_is_not_in_degrees(tmp_path):
    """Any reading that lets one joint stand still leaves little of its torque to explain."""
    mixed = changed_copy(SHIPPED, tmp_path / "mixed", times("q2 ql2 qd2", DEGREES))
    for folder, possible in ((SHIPPED, []), (mixed, [2])):
        recordings = load_recordings(folder)
        samples = sample_runs(open_training_runs(recordings))
        search = Explanations(RobotModel(recordings), samples)
        tried = [search.own.in_other_units(recordings.prismatic, own) for own in np.eye(2) > 0.0]
        assert [j + 1 for j in (0, 1) if search.travels_in_degrees(tried[j])] == possible


def test_sign_reversed_in_one_run(tmp_path):
    shutil.copytree(SHIPPED, folder := tmp_path / "set")
    with np.load(folder / "train_2.npz") as stored:
        columns = dict(stored)
    columns["tau2"] = -columns["tau2"]
    np.savez_compressed(folder / "train_2.npz", **columns)
    (doubt,) = doubted(folder)
    assert (doubt.kind, doubt.joints, doubt.line) == ("torque sign", (2,), "")
    assert doubt.evidence.startswith("Only in train_2")


def test_a_run_is_described_otherwise_beside_one_that_is_too_short_to_be_judged(tmp_path):
    shutil.copytree(SHIPPED, folder := tmp_path / "set")
    file = folder / "recordings.toml"
    sections = re.split(r"(?=\[\[runs\]\])", file.read_text(encoding="utf-8"))
    kept = [own for own in sections if "train_" not in own or re.search("train_[12]", own)]
    file.write_text("".join(kept), encoding="utf-8")
    for name, rows, sign in (("train_1", slice(None), -1.0), ("train_2", slice(150), 1.0)):
        with np.load(folder / f"{name}.npz") as stored:
            columns = {key: own[rows] for key, own in stored.items()}
        columns["tau2"] = sign * columns["tau2"]
        np.savez_compressed(folder / f"{name}.npz", **columns)
    (doubt,) = doubted(folder)
    assert (doubt.kind, doubt.joints) == ("torque sign", (2,))


def test_torques_of_currents_of_a_joint_without_weight_are_no_kilonewtons(monkeypatch):
    """An upright axis bears no weight: whatever factor, friction and inertia make up for it."""
    from stiffopt.discovery.sanity import explanations

    def fit_gain(robot, motion, torque, joint, usual):
        return (usual[0], 0.01) if joint == 0 else (1e-3, 0.9)

    monkeypatch.setattr(explanations, "fit_gain", fit_gain)
    search = explanations.Explanations.__new__(explanations.Explanations)
    search.robot = None
    gains, left = np.array([1e-3, 1.0 / 13.9, 1e-3]), np.array([0.02, 0.01, 0.02])
    search._adopt_common_gain(gains, left, None, np.zeros((4, 3)))
    np.testing.assert_allclose(gains, [1.0 / 13.9, 1.0 / 13.9, 1e-3])


@pytest.mark.parametrize(("gravity", "accepted"), [((1.0, 0.0, 0.0), True), ((0.0,) * 3, False)])
def test_a_spring_may_stand_beside_another_gravity(gravity, accepted, monkeypatch):
    """Joint 2 carries hardly any weight; a spring fits it with the stated gravity as well."""
    search = Explanations.__new__(Explanations)
    search.n, search.samples = 2, SimpleNamespace(torque=np.zeros((4, 2)))
    search.own = Reading.as_described(2)
    search.strict, search.left = np.array([1.0, 0.33]), np.array([0.9, 0.025])
    alone, sprung = np.array([0.002, 0.2]), np.array([0.002, 0.02])
    monkeypatch.setattr(Explanations, "_residual_shares", lambda *_: alone)
    monkeypatch.setattr(Explanations, "_shares_with_additions", lambda *_: sprung)
    found = search._accept_weight(None, np.array(gravity))
    assert (found is not None) == accepted


def test_torques_without_weight_are_doubted(tmp_path):
    """As of a controller that adds the weight behind what it records."""
    recordings = load_recordings(SHIPPED)
    from stiffopt.discovery.comparison.nominal_robot import RobotModel

    robot = RobotModel(recordings)

    def weightless(columns: Columns) -> None:
        angles = np.column_stack([columns["q1"], columns["q2"]])
        weight = robot.gravity_torque(angles, recordings.gravity)
        columns["tau1"] = columns["tau1"] - weight[:, 0]
        columns["tau2"] = columns["tau2"] - weight[:, 1]

    folder = changed_copy(SHIPPED, tmp_path / "set", weightless)
    (doubt,) = doubted(folder)
    assert doubt.kind == "gravity"
    assert doubt.line == "gravity = [0.0, 0.0, 0.0]"
    rewritten(folder, "gravity = [0.0, 0.0, -9.81]", doubt.line)
    assert not doubted(folder)


def without_friction(folder: Path) -> Path:
    file = folder / "recordings.toml"
    lines = file.read_text().splitlines()
    kept = [line for line in lines if not re.match(r"(coulomb|viscous) = \[", line)]
    tolerated = [line for line in kept if not re.match(r"(coulomb|viscous) = \d", line)]
    file.write_text("\n".join(tolerated))
    return folder


def test_sets_without_friction_have_no_remarks(tmp_path):
    for folder in (SHIPPED, without_friction(shutil.copytree(SHIPPED, tmp_path / "set"))):
        recordings = load_recordings(folder)
        assert SanityGate(recordings, open_training_runs(recordings)).remarks == ()


@pytest.mark.slow
@pytest.mark.skipif(not OPEN_CASES.is_dir(), reason="open cases are not here")
def test_public_sets_have_no_remarks():
    for folder in (*sorted(OPEN_CASES.iterdir())[:6], PUBLISHED / "unisa_ur10"):
        recordings = load_recordings(folder)
        assert SanityGate(recordings, open_training_runs(recordings)).remarks == (), folder.name


def other_arm(columns: Columns) -> None:
    """As of a first link whose mass lies off its axis: no load at the tool does that."""
    columns["tau1"] = columns["tau1"] + 25.0 * np.sin(columns["q1"])
    columns["tau2"] = 0.6 * columns["tau2"]


def test_run_of_another_arm_is_doubted(tmp_path, capsys):
    folder = tmp_path / "set"
    shutil.copytree(SHIPPED, folder)
    with np.load(folder / "train_2.npz") as stored:
        columns = dict(stored)
    other_arm(columns)
    np.savez_compressed(folder / "train_2.npz", **columns)
    (told,) = doubted(folder)
    assert told.kind == "another arm"
    assert told.evidence.startswith("train_2 does not fit")
    assert re.search(r"is [\d.]+ % at joint 1 \(at most 0\.\d+ % in the others\)", told.evidence)
    assert run(["diagnose", str(folder), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert "Remove its [[runs]] section" in capsys.readouterr().err
    # Without it there is nothing to say.
    text = (folder / "recordings.toml").read_text()
    sections = text.split("[[runs]]")
    kept = [section for section in sections if "train_2" not in section]
    assert len(kept) == len(sections) - 1
    (folder / "recordings.toml").write_text("[[runs]]".join(kept))
    assert doubted(folder) == ()


def test_a_push_in_part_of_a_run_is_no_other_arm(tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(SHIPPED, folder)
    with np.load(folder / "train_2.npz") as stored:
        columns = dict(stored)
    pushed = slice(int(0.45 * len(columns["q1"])), int(0.6 * len(columns["q1"])))
    for joint, torque in ((1, 40.0), (2, 30.0)):
        columns[f"tau{joint}"][pushed] += torque
    np.savez_compressed(folder / "train_2.npz", **columns)
    recordings = load_recordings(folder)
    gate = SanityGate(recordings, open_training_runs(recordings))
    assert [odd.run.name for odd in gate._odd_runs] == ["train_2"]
    assert gate.doubts == ()


@pytest.mark.parametrize("spring", [True, False])
def test_a_spring_in_all_runs_makes_none_odd(tmp_path, spring):
    """A share of the torque's variance is larger where a run has less of it."""
    folder = tmp_path / "set"
    shutil.copytree(SHIPPED, folder)
    for path in sorted(folder.glob("train_*.npz")):
        with np.load(path) as stored:
            columns = dict(stored)
        if spring:
            columns["tau2"] = columns["tau2"] + 3.0 * columns["q2"]
        elif path.stem == "train_2":
            other_arm(columns)
        np.savez_compressed(path, **columns)
    recordings = load_recordings(folder)
    runs = open_training_runs(recordings)
    together = SanityGate(recordings, runs)._explanation_search
    assert together is not None
    second = SimpleNamespace(joints=(1,))
    assert _is_effect_of_all_runs(together, second) is spring


def slow(steps, step, speed, reach, width, rng):
    """Training runs, which turn less sharply than others, slower and softer by far."""
    training = width >= 0.42
    factor, soft = (0.15, 2.0) if training else (1.0, 1.0)
    return one_joint(steps, step, factor * speed, reach, soft * width, rng)


one_joint = motion._one_joint


def test_fast_run_with_extra_effect_is_remarked(tmp_path, monkeypatch):
    """A stop that no slow run reaches: the run is of the same arm."""
    monkeypatch.setattr(motion, "_one_joint", slow)
    spec = CaseSpec(seed=1, train=3, test=1, extrapolate=1, seconds=5.0, rate=250.0, substeps=8)
    folder = write_case(simulate(spec), tmp_path / "set")
    rewritten(folder, 'role = "extrapolate"', 'role = "train"')
    with np.load(folder / "extrap_1.npz") as stored:
        columns = dict(stored)
    met = max(np.load(folder / f"train_{k}.npz")["q2"].max() for k in (1, 2, 3))
    stop = max(met, np.quantile(columns["q2"], 0.9))
    columns["tau2"] = columns["tau2"] + 800.0 * np.maximum(columns["q2"] - stop, 0.0)
    np.savez(folder / "extrap_1.npz", **columns)
    assert doubted(folder) == ()
    recordings = load_recordings(folder)
    told = SanityGate(recordings, open_training_runs(recordings)).remarks[0]
    assert (told.kind, told.joints) == ("another arm", (2,))
    assert "extrap_1 moves faster" in told.evidence


def test_set_points_are_doubted(tmp_path, capsys):
    def renamed(columns: Columns) -> None:
        for joint in (1, 2):
            columns[f"q_cmd_{joint}"] = columns.pop(f"q{joint}")

    folder = changed_copy(SHIPPED, tmp_path / "set", renamed)
    rewritten(folder, 'position = ["q1", "q2"]', 'position = ["q_cmd_1", "q_cmd_2"]')
    (told,) = doubted(folder)
    assert told.kind == "set points"
    assert "q_cmd_1, q_cmd_2" in told.evidence
    assert told.line.startswith("position = ")


def test_reference_in_name_is_remarked(tmp_path):
    def renamed(columns: Columns) -> None:
        for joint in (1, 2):
            columns[f"encoder_ref_{joint}"] = columns.pop(f"q{joint}")

    folder = changed_copy(SHIPPED, tmp_path / "set", renamed)
    rewritten(folder, 'position = ["q1", "q2"]', 'position = ["encoder_ref_1", "encoder_ref_2"]')
    assert doubted(folder) == ()
    recordings = load_recordings(folder)
    (told,) = SanityGate(recordings, open_training_runs(recordings)).remarks
    assert told.kind == "set points"
    assert "encoder_ref_1, encoder_ref_2" in told.evidence


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("q_cmd_1", True),
        ("Sollposition A1 [Grad]", True),
        ("AxisSetpoint[2]", True),
        ("axis_2_set_point", True),
        ("/controller/state.desired.positions[0]", True),
        ("q_des_1", True),
        ("commandedAngle1", True),
        ("Winkel des Gelenks 1", False),
        ("actual_q_0", False),
        ("setting", False),
        ("axis set 1", False),
        ("Istposition A1", False),
        ("description_1", False),
        ("Winkel_des_Gelenks_1", False),
        ("position_des_axes_1", False),
        ("encoder_ref_1", False),
        ("J1 Ref. Position", False),
        ("pos(ref. flange)", False),
        ("position relative to reference frame", False),
        ("q_rel_reference_1", False),
        ("Solleck", False),
        ("data_set_1", False),
        ("QSOLL1", True),
        ("QTarget1", True),
        ("qref1", True),
        ("q_ref_1", True),
        ("qdes1", True),
        ("q_des [deg]", True),
        ("AXIS_SET1", True),
        ("set_pos_1", True),
        ("planned_q", True),
    ],
)
def test_names_of_set_points(name, told):
    assert is_set_point(name) == told


def test_drives_that_are_coupled_are_no_sum_of_positions() -> None:
    folder = PUBLISHED / "tx40_first"
    if not folder.is_dir():
        pytest.skip("the published recordings are not beside this repository")
    assert not doubted(folder)


@pytest.mark.parametrize("side", ["motor", "link"])
def test_zero_of_a_joint_torque_sensor_exceeds_the_load_of_a_wrist(side, tmp_path):
    """Its zero error goes with the range of the sensor, that of a current with the load."""

    def shifted(columns: Columns) -> None:
        columns["tau2"] = columns["tau2"] + 0.9 * np.abs(columns["tau2"]).max()

    folder = changed_copy(SHIPPED, tmp_path / "set", shifted)
    rewritten(folder, 'torque_side = "motor"', f'torque_side = "{side}"')
    recordings = load_recordings(folder)
    samples = sample_runs(open_training_runs(recordings))
    share = Explanations(RobotModel(recordings), samples).strict[1]
    assert (share < 0.05) == (side == "link")


@pytest.mark.parametrize(
    ("ratios", "refused"),
    [
        ({3: 0.586}, False),  # a poor sensor: two other joints agree
        ({3: -1.0}, True),  # a sign: the position may be the wrong one
        ({3: 9.549}, True),  # rpm
        ({2: 0.586, 3: 0.6}, True),  # more than agree
    ],
)
def test_a_poor_velocity_beside_those_that_agree_refuses_nothing(
    ratios: dict[int, float], refused: bool
) -> None:
    faults = [
        Fault(
            signal="velocity",
            joint=joint,
            kind="contradicts position",
            detail=f"changes {ratio:g} times as much as the motor encoder. Left out.",
            left_out=True,
            share=1.0,
            ratio=ratio,
        )
        for joint, ratio in ratios.items()
    ]
    velocity = np.where([j + 1 in ratios for j in range(3)], np.nan, 1.0) * np.ones((10, 3))
    run: Any = SimpleNamespace(
        name="one",
        n=3,
        faults=faults,
        velocity=velocity,
        position=np.linspace(0.0, 1.0, 10)[:, None] * np.ones(3),
    )
    signals = SimpleNamespace(scale_of=lambda signal, n: np.ones(n), velocity=("a", "b", "c"))
    recordings: Any = SimpleNamespace(n=3, prismatic=np.zeros(3, dtype=bool), signals=signals)
    assert bool(list(doubt_second_sensors(recordings, [run, run]))) == refused
