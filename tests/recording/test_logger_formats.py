"""Layouts of loggers: the same motion by each format's own library, to a recording set."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.errors import InputError, InputFileError
from stiffopt.recording.readers.read import read_columns, read_tables
from stiffopt.recording.recording_set import load_recordings
from stiffopt.recording.signals import Signals, is_set_point

URDF = ROOT / "problems" / "recordings" / "two_link_friction" / "robot.urdf"
LOGS = ROOT.parent / "shared" / "cases" / "logs"
SHARED = LOGS if LOGS.is_dir() else None
TIME = np.arange(0.0, 4.0, 0.005)
Q = np.column_stack([np.sin(TIME), 0.8 * np.cos(2.0 * TIME)])
QD = np.column_stack([np.cos(TIME), -1.6 * np.sin(2.0 * TIME)])
TAU = np.column_stack([9.0 * np.sin(3.0 * TIME), 4.0 * np.cos(TIME)])
ARRAYS = {"t": TIME, "q": Q, "qd": QD, "tau": TAU}
HEAD = ["t", *(f"{name}{j}" for name in ("q", "qd", "tau") for j in (1, 2))]
ROWS = np.column_stack([TIME, Q, QD, TAU])


def write_mat5(path):
    pytest.importorskip("scipy.io").savemat(path, {"log": ARRAYS, "note": "bench 7"})


def write_mat73(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in ARRAYS.items():
            # MATLAB stores by columns.
            file[name] = np.atleast_2d(values.T)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(512))


def write_hdf5(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in ARRAYS.items():
            file[f"run/{name}"] = values
        file["run/image"] = np.zeros((len(TIME), 8, 8))


def write_xlsx(path):
    workbook = pytest.importorskip("openpyxl").Workbook()
    workbook.active.append(HEAD)
    for row in ROWS.tolist():
        workbook.active.append(row)
    workbook.create_sheet("notes").append(["bench 7"])
    workbook.save(path)


def write_json(path):
    data = {name: values.tolist() for name, values in ARRAYS.items()}
    path.write_text(json.dumps({"robot": "two links", "rate": 200, "data": data}))


def records():
    return [{"stamp": float(t), "joints": {"q": q, "qd": qd, "tau": tau}}
            for t, q, qd, tau in zip(TIME, Q.tolist(), QD.tolist(), TAU.tolist(), strict=True)
            ]  # fmt: skip


def write_jsonl(path):
    # The logger was stopped within its last line.
    path.write_text("\n".join(map(json.dumps, records())) + '\n{"stamp": 4.0, "jo')


def write_echo(path):
    text = []
    for t, q, qd, tau in zip(TIME, Q, QD, TAU, strict=True):
        text += ["header:", "  stamp:", f"    sec: {int(t)}",
                 f"    nanosec: {round(1e9 * (t % 1.0))}", "  frame_id: ''", "name:",
                 "- elbow", "- shoulder"]  # fmt: skip
        for field, values in (("position", q), ("velocity", qd), ("effort", tau)):
            text += [f"{field}:", *(f"- {v!r}" for v in map(float, values))]
        text.append("---")
    path.write_text("\n".join(text))


def write_lists(path):
    """As pandas writes a data frame of NumPy arrays, wrapped within the cell."""
    cells = [f'{k},{row[0]},"[{row[1]}\n {row[2]}]","[{row[3]} {row[4]}]","[{row[5]}, {row[6]}]"'
             for k, row in enumerate(ROWS)]  # fmt: skip
    path.write_text("\n".join([",time,joint_positions,joint_velocities,joint_torques", *cells]))


def write_brackets(path):
    head = [f"{name}[{j}]" for name in ("qpos", "qvel", "actuator_force") for j in (0, 1)]
    np.savetxt(path, ROWS, header=",".join(["time", *head]), delimiter=",", comments="")


WRITERS = {
    "log.mat": write_mat5,
    "log73.mat": write_mat73,
    "log.hdf5": write_hdf5,
    "log.xlsx": write_xlsx,
    "log.json": write_json,
    "log.jsonl": write_jsonl,
    "echo.txt": write_echo,
    "lists.csv": write_lists,
    "brackets.csv": write_brackets,
    "matrix.txt": lambda path: np.savetxt(path, ROWS),
    "matrix.npy": lambda path: np.save(path, ROWS),
    "arrays.npz": lambda path: np.savez(path, **ARRAYS),
}


def started(path, urdf=URDF):
    out = path.parent / "set"
    assert run(["init", "recording", str(path), "--urdf", str(urdf), "-o", str(out)]) == 0
    return load_recordings(out)


@pytest.mark.parametrize("name", WRITERS)
def test_each_format_becomes_a_set(name, tmp_path, capsys):
    WRITERS[name](tmp_path / name)
    found = started(tmp_path / name)
    assert "QUESTION" not in capsys.readouterr().out
    assert found.signals.velocity is not None
    runs = [found.open(entry) for entry in found.runs]
    for kind, values in (("position", Q), ("velocity", QD), ("torque", TAU)):
        stored = np.concatenate([getattr(each, kind) for each in runs])
        np.testing.assert_allclose(stored, values, atol=1e-12)


@pytest.mark.parametrize("name", [n for n in WRITERS if n not in ("matrix.txt", "matrix.npy")])
def test_a_set_names_columns_of_the_log_itself(name, tmp_path):
    """Without a conversion, under the names that `init recording` tells."""
    WRITERS[name](tmp_path / name)
    (table,) = read_tables(tmp_path / name).values()
    names = list(table)
    signals = Signals(
        time=names[-7], position=tuple(names[-6:-4]), velocity=None, link_position=None,
        torque=tuple(names[-2:]),
    )  # fmt: skip
    found = read_columns(tmp_path / name, signals)
    np.testing.assert_allclose(found[names[-1]], TAU[:, 1], atol=1e-12)
    missing = Signals(
        time=names[-7], position=("nowhere",), velocity=None, link_position=None, torque=("tau",)
    )
    with pytest.raises(InputFileError, match="no column 'nowhere'"):
        read_columns(tmp_path / name, missing)


def test_groups_of_hdf5_are_runs(tmp_path):
    """As robomimic stores demonstrations; a run is named by its group."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "demo.hdf5", "w") as file:
        for k in range(3):
            for name, values in ARRAYS.items():
                file[f"data/demo_{k}/obs/{name}"] = (k + 1.0) * values
    assert list(read_tables(tmp_path / "demo.hdf5")) == ["demo_0", "demo_1", "demo_2"]
    found = started(tmp_path / "demo.hdf5")
    assert [entry.name for entry in found.runs] == ["demo_demo_0", "demo_demo_1", "demo_demo_2"]
    assert [entry.role for entry in found.runs] == ["train", "train", "test"]
    signals = Signals(
        time="t", position=("q[0]",), velocity=None, link_position=None, torque=("tau[0]",)
    )
    one = read_columns(tmp_path / "demo.hdf5#demo_1", signals)
    np.testing.assert_allclose(one["q[0]"], 2.0 * Q[:, 0])
    with pytest.raises(InputFileError, match=r"runs demo_0, demo_1, demo_2\. Name one .*#demo_0"):
        read_columns(tmp_path / "demo.hdf5", signals)


def test_one_file_a_signal_is_one_run(tmp_path):
    folder = tmp_path / "bench"
    folder.mkdir()
    for name, values in (("joint_positions", Q), ("joint_velocities", QD), ("joint_torques", TAU)):
        np.savetxt(folder / f"{name}.csv", np.column_stack([TIME, values]), delimiter=",",
                   header="time,a,b", comments="")  # fmt: skip
    found = started(folder)
    assert found.signals.torque == ("joint_torques[0]", "joint_torques[1]")
    assert [entry.role for entry in found.runs] == ["train", "test"]


def test_columns_of_no_known_order_are_questioned(tmp_path, capsys):
    """Positions and torques only: their order shows in no rate of change."""
    np.savetxt(tmp_path / "log.txt", np.column_stack([TIME, Q, TAU]))
    started(tmp_path / "log.txt")
    assert "QUESTION: is this their order?" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["log.mat", "log73.mat", "log.hdf5", "log.xlsx", "arrays.npz"])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9])
def test_cut_files_are_refused_by_the_name_of_their_format(name, share, tmp_path, capsys):
    WRITERS[name](tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
    arguments = ["init", "recording", str(tmp_path / name), "--urdf", str(URDF)]
    assert run([*arguments, "-o", str(tmp_path / "set")]) == 2
    assert "cannot be read as" in capsys.readouterr().err
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("name", "told"),
    [("log.bag", "bag of ROS 1.*rosbags-convert"), ("log.pkl", "pickle.*numpy.savez"),
     ("log.xls", "Excel workbook of 1997.*xlsx"), ("log.tdms", "LabVIEW")],
)  # fmt: skip
def test_formats_that_are_not_read_are_named_with_a_way(name, told, tmp_path):
    (tmp_path / name).write_bytes(b"\x80\x04")
    with pytest.raises(InputError, match=told):
        read_tables(tmp_path / name)


@pytest.mark.parametrize("text", ['{"q": [1, 2', '{"a": 1}\n{"a": \n{"a": 3}', '{"a": "b"}'])
def test_spoiled_json_is_told_with_its_line(text, tmp_path, capsys):
    (tmp_path / "log.jsonl").write_text(text)
    assert run(["init", "recording", str(tmp_path / "log.jsonl"), "--urdf", str(URDF)]) == 2
    assert "log.jsonl" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "is_one"),
    [("state.q_d[0]", True), ("state.tau_J_d[3]", True), ("goal_position_1", True),
     ("leader_pos_2", True), ("action[shoulder]", True), ("actions[0]", True), ("ctrl[0]", True),
     ("state.dq[0]", False), ("qd_1", False), ("q[0]", False), ("id_1_pos", False)],
)  # fmt: skip
def test_set_points_of_controllers_and_teleoperation(name, is_one):
    assert is_set_point(name) == is_one


NO_TORQUE = ("cmdpos.csv", "demo.hdf5")


@pytest.mark.parametrize(
    "name", sorted(p.name for p in SHARED.iterdir()) if SHARED else ["log.mat"]
)
def test_published_layouts_become_sets(name, tmp_path, capsys):
    if SHARED is None:
        pytest.skip("the folder of shared logs is absent")
    urdf = SHARED.parent / "diagnosis" / "zero_offset" / "robot.urdf"
    out = tmp_path / "set"
    arguments = ["init", "recording", str(SHARED / name), "--urdf", str(urdf), "-o", str(out)]
    cause = "command" if name in NO_TORQUE else "torque"
    assert run([*arguments, "--rate", "125"] if name in NO_TORQUE else arguments) == 0
    told = capsys.readouterr().out
    assert "QUESTION" not in told
    signals = tomllib.loads((out / "recordings.toml").read_text())["signals"]
    for kind in ("position", cause):
        assert len(signals[kind]) == 6
        assert all(is_set_point(each) == (kind == "command") for each in signals[kind])


@pytest.mark.parametrize(("bits", "each"), [(12, "0.00153398"), (16, "9.58738e-05")])
def test_ticks_are_counts(bits, each, tmp_path, capsys):
    """Positions as whole numbers, up to those of one turn, are no degrees."""
    turn = 2**bits
    ticks = np.round(turn / 2 + 0.4 * turn * Q)
    table = np.column_stack([TIME, ticks, np.round(300.0 * QD), TAU])
    np.savetxt(tmp_path / "log.csv", table, header=",".join(HEAD), delimiter=",", comments="")
    arguments = ["init", "recording", str(tmp_path / "log.csv"), "--urdf", str(URDF)]
    assert run([*arguments, "-o", str(tmp_path / "set")]) == 0
    assert f"{each} rad per count if one turn has {turn}" in capsys.readouterr().out
    signals = tomllib.loads((tmp_path / "set" / "recordings.toml").read_text())["signals"]
    assert signals["scale"]["position"] == "counts"
    assert "velocity" not in signals
    assert run(["recording", "check", str(tmp_path / "set")]) == 2
    told = capsys.readouterr().err
    assert "is in counts of an encoder" in told
    assert "offset in [signals]" in told
