"""A set folder becomes arrays in the set's order, or one message that says what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from recording_sets import motion

from stiffopt.errors import InputError, InputFileError
from stiffopt.exact.chain import exact_windup
from stiffopt.recording.recording_set import load_recordings, require_test_runs
from stiffopt.robot.files import load_robot

MakeSet = Callable[..., Path]


def test_entries_of_the_file_are_in_the_set(make_set: MakeSet) -> None:
    recordings = load_recordings(make_set())
    assert recordings.joints == ("swing", "slide")
    assert recordings.prismatic.tolist() == [False, True]
    assert recordings.torque_side == "motor"
    np.testing.assert_array_equal(recordings.robot.coulomb, [1.0, 2.0])
    assert recordings.unstated == ("viscous", "rotor_inertia")
    assert recordings.tolerance.mass == 0.01
    assert recordings.tolerance.com is None
    np.testing.assert_array_equal(recordings.noise.torque, [0.05, 0.05])
    first, second = recordings.runs
    assert (first.name, first.role, first.session_time) == ("one", "train", 60.0)
    np.testing.assert_array_equal(first.temperature, [25.0, 26.0])
    assert second.temperature is None
    assert recordings.with_role("test", "extrapolate") == (second,)
    require_test_runs(recordings)
    silent = " ".join(recordings.assumptions)
    for word in ("Gravity", "nominal.viscous", "com", "nominal.reducer"):
        assert word in silent
    assert "nominal.coulomb" not in silent


def test_opened_run_has_the_recorded_columns(make_set: MakeSet) -> None:
    recordings = load_recordings(make_set())
    run = recordings.open(recordings.runs[0])
    data = motion(seed=1)
    assert run.faults == ()
    assert (run.name, run.file, run.role) == ("one", "one.npz", "train")
    np.testing.assert_array_equal(run.time, data["t"])
    np.testing.assert_array_equal(run.stamps, data["t"])
    np.testing.assert_array_equal(run.torque, np.column_stack([data["tau1"], data["tau2"]]))
    assert run.link_position is not None
    np.testing.assert_array_equal(run.link_position[:, 0], data["ql1"])
    assert np.isnan(run.link_position[:, 1]).all()
    assert run.usable


def test_predictions_have_units_and_delay_of_the_set(make_set: MakeSet) -> None:
    """In its units, one a joint where they differ, and as late as its torques."""
    signals = load_recordings(make_set()).signals
    scaled = replace(
        signals,
        scale={"time": np.array(1e-3), "torque": np.array([1e-3, 13.9])},
        torque_delay=0.02,
    )
    time = np.arange(0.0, 2.0, 0.004)
    channels = {
        signals.time: time,
        signals.torque[0]: np.full(len(time), 4.0),
        signals.torque[1]: time,
        signals.position[1]: time,
    }
    written = scaled.as_recorded(channels)
    assert written[signals.time] == pytest.approx(1e3 * time)
    assert written[signals.torque[0]] == pytest.approx(np.full(len(time), 4e3))
    assert np.all(np.isfinite(written[signals.torque[1]]))
    back = scaled.to_si(written)
    for name, values in channels.items():
        inside = slice(5, -5)
        assert back[name][inside] == pytest.approx(values[inside])
    assert signals.as_recorded(channels).keys() == channels.keys()


def test_set_may_list_joints_in_another_order(make_set: MakeSet) -> None:
    """Gravity torque in the set's order, against a balance of forces by hand."""
    folder = make_set(
        ('joints = ["swing", "slide"]', 'joints = ["slide", "swing"]'),
        ('link_position = ["ql1", ""]', 'link_position = ["", "ql1"]'),
    )
    recordings = load_recordings(folder)
    assert recordings.order.tolist() == [1, 0]
    assert recordings.prismatic.tolist() == [True, False]
    slide, swing = 0.15, 0.4
    position = np.zeros(2)
    position[recordings.order] = [slide, swing]
    model = recordings.robot.model
    torque = pin.computeGeneralizedGravity(model, model.createData(), position)[recordings.order]
    lever = 2.0 * 0.2 + 1.0 * (slide + 0.1)
    np.testing.assert_allclose(
        torque, [-9.81 * 1.0 * np.cos(swing), 9.81 * lever * np.sin(swing)], rtol=1e-12
    )


def test_unrecorded_joints_are_locked(make_set: MakeSet) -> None:
    edits = [
        ('joints = ["swing", "slide"]', 'joints = ["slide"]'),
        ('position = ["q1", "q2"]', 'position = ["q2"]'),
        ('velocity = ["qd1", "qd2"]\nlink_position = ["ql1", ""]\n', ""),
        ('torque = ["tau1", "tau2"]', 'torque = ["tau2"]'),
        ("gear_ratio = [101.0, 50.0]\ncoulomb = [1.0, 2.0]", "coulomb = [2.0]"),
        ("housing_temperature = [25.0, 26.0]", "housing_temperature = 25.0"),
    ]
    recordings = load_recordings(make_set(*edits))
    assert recordings.robot.model.nv == 1
    assert recordings.locked == ("swing",)
    assert any("swing" in sentence for sentence in recordings.assumptions)
    np.testing.assert_array_equal(recordings.runs[0].temperature, [25.0])


def test_shipped_robot_is_loaded_without_rotors(make_set: MakeSet) -> None:
    names = ["joint_1", "joint_2"]
    folder = make_set(
        ('robot = "robot.urdf"', 'robot = "er3a_c60"'),
        ('joints = ["swing", "slide"]', f"joints = {names}".replace("'", '"')),
        ('tool_frame = "tool0"\n', ""),
        ("[signals]", "gravity = [0.0, 0.0, 9.81]\n\n[signals]"),
    )
    robot = load_robot("er3a_c60")
    names = list(robot.joint_names[:2])
    text = (folder / "recordings.toml").read_text()
    text = text.replace('["joint_1", "joint_2"]', str(names).replace("'", '"'))
    (folder / "recordings.toml").write_text(text)
    recordings = load_recordings(folder)
    assert recordings.locked == tuple(robot.joint_names[2:])
    assert recordings.gravity.tolist() == [0.0, 0.0, 9.81]
    assert not np.any(recordings.robot.model.armature)


def test_counterbalance_spring_pulls_to_its_offset(make_set: MakeSet) -> None:
    spring = (
        '[nominal.counterbalance]\njoint = "swing"\ntype = "spring"\nstiffness = 20.0\n'
        "offset = 0.1\n\n[tolerance]"
    )
    balance = load_recordings(make_set(("[tolerance]", spring))).nominal.counterbalance[0]
    assert balance.joint == 0
    np.testing.assert_allclose(balance.at(np.array([0.1, 0.6])), [0.0, -10.0])
    table = (
        '[[nominal.counterbalance]]\njoint = 2\ntype = "table"\nangle = [0.0, 1.0, 2.0]\n'
        "torque = [0.0, 4.0, 6.0]\n\n[tolerance]"
    )
    balance = load_recordings(make_set(("[tolerance]", table))).nominal.counterbalance[0]
    assert balance.joint == 1
    np.testing.assert_allclose(balance.at(np.array([0.5, 1.5, 9.0])), [2.0, 5.0, 6.0])


REDUCER = "[nominal.reducer]\nK1 = [{0}, 1e4]\nK2 = [2e4, 2e4]\nK3 = [3e4, inf]\nT1 = [7.0, 7.0]\n"


def test_infinite_reducer_slope_is_rigid(make_set: MakeSet) -> None:
    text = REDUCER.format("1e4") + "T2 = [25.0, 25.0]\n\n[tolerance]"
    swing, slide = load_recordings(make_set(("[tolerance]", text))).robot.chains
    assert swing is not None
    assert slide is None
    angle = 7.0 / 1e4 + 18.0 / 2e4 + 15.0 / 3e4
    assert exact_windup(swing, np.array([40.0])) == pytest.approx([angle], rel=1e-12)


WRONG = {
    "torque missing": (
        'torque = ["tau1", "tau2"]\n',
        "",
        r"signals\.torque: no joint has a torque",
    ),
    "torque nowhere": ('["tau1", "tau2"]', '["", ""]', r"signals\.torque: no joint has a torque"),
    "no position": ('["q1", "q2"]', '["q1", ""]', r"signals\.position: every joint needs"),
    "count": (
        '["q1", "q2"]',
        '["q1"]',
        r"signals\.position: needs one column a joint \(2\), got 1",
    ),
    "twice": ('["qd1", "qd2"]', '["q1", "qd2"]', r"'q1' is already used for position of joint 1"),
    "joint": ('"slide"]', '"slid"]', r"joints\[2\]: .* no moving joint 'slid'.*mean 'slide'"),
    "run with a backslash": ('"one.npz"', '"o\\\\ne.npz"', "backslash or control character"),
    "joint twice": ('"slide"]', '"swing"]', r"'swing' is named twice"),
    "frame": ('"tool0"', '"tool"', r"tool_frame: .* no frame 'tool'.*mean 'tool0'"),
    "key": ("coulomb =", "coulom =", r"nominal\.coulom: unknown key.*mean 'coulomb'"),
    "list": ("[1.0, 2.0]", "[1.0]", r"nominal\.coulomb: needs one number a joint \(2\), got 1"),
    "sign": ("[1.0, 2.0]", "[1.0, -2.0]", r"nominal\.coulomb\[2\].*finite number, 0 or above"),
    "ratio": ("[101.0, 50.0]", "[101.0, 0.0]", r"gear_ratio: a ratio of 0 turns nothing"),
    "role": ('role = "test"', 'role = "tests"', r"runs\[2\]\.role: got 'tests'.*mean 'test'"),
    "session": (
        'role = "test"',
        'role = "test"\nsession_time = -5.0',
        r"runs\[2\]\.session_time.*finite number, 0 or above",
    ),
    "names": ('file = "two.npz"', 'file = "one.csv"', r"runs\[2\]\.file: 'one.csv' has the name"),
    "outside": ('"two.npz"', '"../two.npz"', r"'\.\./two\.npz' lies outside of the set"),
    "robot": ('"robot.urdf"', '"robots.urdf"', r"robots\.urdf: no such file.*robot\.urdf"),
    "schema": ("schema = 1", "schema = 2", r"schema: this version reads schema = 1, got 2"),
    "toml": ("[signals]", "[signals", r"line \d+: is not valid TOML"),
    "reducer": ("[tolerance]", REDUCER.format("1e4") + "[tolerance]", r"reducer\.T2.*required"),
    "soft": (
        "[tolerance]",
        REDUCER.format("0.0") + "T2 = [25.0, 25.0]\n[tolerance]",
        r"reducer\.K1\[1\].*number above 0",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_recording_files_are_refused(make_set: MakeSet, case: str) -> None:
    old, new, says = WRONG[case]
    with pytest.raises(InputError, match=r"(?s)(recordings\.toml|robots\.urdf).*") as caught:
        load_recordings(make_set((old, new)))
    caught.match(says)


def test_set_without_test_runs_is_refused(make_set: MakeSet) -> None:
    recordings = load_recordings(make_set(('role = "test"', 'role = "train"')))
    with pytest.raises(InputFileError, match=r'runs: none of the 2 runs has role = "test"'):
        require_test_runs(recordings)
    recordings = load_recordings(make_set(('role = "train"', 'role = "test"')))
    with pytest.raises(InputFileError, match=r'has role = "train" .*one.npz: test'):
        require_test_runs(recordings)


def test_runs_are_opened_individually(make_set: MakeSet) -> None:
    """A set whose test run is absent can be read until that run is asked for."""
    folder = make_set()
    (folder / "two.npz").unlink()
    recordings = load_recordings(folder)
    recordings.open(recordings.runs[0])
    with pytest.raises(InputFileError, match=r"two\.npz: no such file.*one\.npz"):
        recordings.open(recordings.runs[1])


def test_run_with_other_columns_is_refused(make_set: MakeSet) -> None:
    data = motion()
    data["torque_1"] = data.pop("tau1")
    recordings = load_recordings(make_set(two=data))
    with pytest.raises(InputFileError, match=r"two\.npz: has no column 'tau1'"):
        recordings.open(recordings.runs[1])


def test_folder_without_set_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"recordings\.toml: no such file"):
        load_recordings(tmp_path)
    with pytest.raises(InputFileError, match="there is no folder"):
        load_recordings(tmp_path / "nowhere" / "recordings.toml")


def shipped(make_set: MakeSet, *edits: tuple[str, str]) -> Path:
    """A set of two joints of the ER3A, in the other order, that states friction alone."""
    names = load_robot("er3a_c60").joint_names
    return make_set(
        ('robot = "robot.urdf"', 'robot = "er3a_c60"'),
        ('joints = ["swing", "slide"]', f'joints = ["{names[2]}", "{names[1]}"]'),
        ('tool_frame = "tool0"\n', ""),
        *edits,
    )


def test_robot_file_supplies_values_that_the_set_omits(make_set: MakeSet) -> None:
    own = load_robot("er3a_c60")
    recordings = load_recordings(shipped(make_set))
    assert recordings.robot.joint_names == own.joint_names[1:3]
    assert recordings.robot.chains == own.chains[1:3]
    np.testing.assert_array_equal(recordings.robot.rotor_inertia, own.rotor_inertia[1:3])
    # What the set states, in its own order of joints.
    np.testing.assert_array_equal(recordings.robot.coulomb, [2.0, 1.0])
    assert "drivetrains are those of the robot's file" in " ".join(recordings.assumptions)


def test_stiffness_of_the_set_replaces_the_whole_drivetrain(make_set: MakeSet) -> None:
    stated = ("[tolerance]", "contact_stiffness = [2e4, inf]\n\n[tolerance]")
    first, second = load_recordings(shipped(make_set, stated)).robot.chains
    assert first is None
    assert second is not None
    assert exact_windup(second, np.array([10.0])) == pytest.approx([10.0 / 2e4], rel=1e-9)
