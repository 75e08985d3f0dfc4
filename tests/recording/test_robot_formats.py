"""Files as robots and their tools write them: UR's RTDE recorder, KUKA traces, LeRobot datasets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from recording_sets import Columns, motion

from stiffopt.errors import InputFileError
from stiffopt.recording.readers.read import read_columns
from stiffopt.recording.recording_set import RunEntry
from stiffopt.recording.signals import Signals


def short() -> Columns:
    return motion(rate=100.0, duration=1.0)


def signals(time: str, position: tuple[str, str], torque: tuple[str, str]) -> Signals:
    return Signals(time=time, position=position, velocity=None, link_position=None, torque=torque)


def test_csv_of_the_rtde_recorder_is_read(tmp_path: Path) -> None:
    # record.py of RTDE writes one blank between columns, and vectors as NAME_0, NAME_1, ...
    run = short()
    kinds = {"actual_q": ("q1", "q2"), "actual_current": ("tau1", "tau2")}
    names = [
        "timestamp",
        *(f"{name}_{k}" for name in kinds for k in (0, 1)),
        "output_int_register_0",
    ]
    columns = [run["t"], *(run[column] for pair in kinds.values() for column in pair), run["t"] * 0]
    rows = [" ".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True)]
    (tmp_path / "robot_data.csv").write_text("\n".join([" ".join(names), *rows]) + "\n")
    wanted = signals(
        "timestamp", ("actual_q_0", "actual_q_1"), ("actual_current_0", "actual_current_1")
    )
    found = read_columns(tmp_path / "robot_data.csv", wanted)
    np.testing.assert_array_equal(found["timestamp"], run["t"])
    np.testing.assert_array_equal(found["actual_q_1"], run["q2"])
    np.testing.assert_array_equal(found["actual_current_0"], run["tau1"])


def write_trace(
    path: Path, step: float, channels: dict[str, np.ndarray], scale: float = 1.0
) -> None:
    """A .dat with its .r64 as the trace of a KRC4 writes them; columns run against the header."""
    count = len(next(iter(channels.values())))
    head = ["DIAEXTENDED  {@:ENGLISH}", "#BEGINGLOBALHEADER", "101,C:\\KRC", "#ENDGLOBALHEADER"]
    head += ["#BEGINCHANNELHEADER", "200,Zeit", "202,s", "210,IMPLIZIT", f"220,{count}", "240,0",
             f"241,{step!r}", "#ENDCHANNELHEADER"]  # fmt: skip
    for column, name in zip(range(len(channels), 0, -1), channels, strict=True):
        head += ["#BEGINCHANNELHEADER", f"200,{name}", "202,°", "210,EXPLIZIT",
                 f"211,{path.stem}.r64", "213,BLOCK", "214,REAL64", f"220,{count}", f"221,{column}",
                 "240,0", f"241,{scale!r}", "#ENDCHANNELHEADER"]  # fmt: skip
    path.write_text("\r\n".join(head) + "\r\n", encoding="latin-1")
    rows = np.stack(list(channels.values())[::-1], axis=1) / scale
    rows.astype("<f8").tofile(path.with_suffix(".r64"))


def test_kuka_trace_of_axes_and_drives_is_read(tmp_path: Path) -> None:
    run = short()
    axes = {"AxisPos_Act1": run["q1"], "AxisPos_Act2": run["q2"]}
    write_trace(tmp_path / "run_KRCIpo.dat", 0.01, axes)
    fine = np.arange(397) * 0.0025
    for drive, torque in ((1, "tau1"), (2, "tau2")):
        values = np.interp(fine, run["t"], run[torque])
        write_trace(
            tmp_path / f"run_NextGenDrive#{drive}.dat", 0.0025, {"Istmoment": values}, scale=0.25
        )
    wanted = signals(
        "t",
        ("AxisPos_Act1", "AxisPos_Act2"),
        ("NextGenDrive#1.Istmoment", "NextGenDrive#2.Istmoment"),
    )
    found = read_columns(tmp_path / "run_KRCIpo.dat", wanted)
    np.testing.assert_allclose(found["t"], run["t"], atol=1e-12)
    np.testing.assert_array_equal(found["AxisPos_Act1"], run["q1"])
    np.testing.assert_array_equal(found["AxisPos_Act2"], run["q2"])
    np.testing.assert_allclose(found["NextGenDrive#2.Istmoment"], run["tau2"], atol=1e-12)


def test_incomplete_kuka_traces_are_refused(tmp_path: Path) -> None:
    run, path = short(), tmp_path / "run_KRCIpo.dat"
    write_trace(path, 0.01, {"AxisPos_Act1": run["q1"], "AxisPos_Act2": run["q2"]})
    two = ("AxisPos_Act1", "AxisPos_Act2")
    with pytest.raises(InputFileError, match="'Torque1'"):
        read_columns(path, signals("t", two, ("Torque1", "")))
    data = path.with_suffix(".r64")
    data.write_bytes(data.read_bytes()[:-8])
    with pytest.raises(InputFileError, match="no whole rows"):
        read_columns(path, signals("t", two, ("AxisPos_Act1", "")))
    data.unlink()
    with pytest.raises(InputFileError, match="not beside it"):
        read_columns(path, signals("t", two, ("AxisPos_Act1", "")))
    path.write_text("#BEGIN nothing")
    with pytest.raises(InputFileError, match="no KUKA trace"):
        read_columns(path, signals("t", two, ("AxisPos_Act1", "")))


def test_kuka_bytes_that_are_no_numbers_are_missing_samples(tmp_path: Path) -> None:
    """A NaN that signals makes NumPy warn; bytes beyond any measurement are told."""
    run, path = short(), tmp_path / "run_KRCIpo.dat"
    write_trace(path, 0.01, {"AxisPos_Act1": run["q1"], "AxisPos_Act2": run["q2"]})
    data = bytearray(path.with_suffix(".r64").read_bytes())
    data[160:168] = bytes.fromhex("010000000000f07f")
    path.with_suffix(".r64").write_bytes(data)
    wanted = signals("t", ("AxisPos_Act1", "AxisPos_Act2"), ("", ""))
    found = read_columns(path, wanted)
    assert sum(np.isnan(found[name]).sum() for name in wanted.position) == 1
    data[160:168] = b"\x77" * 8
    path.with_suffix(".r64").write_bytes(data)
    with pytest.raises(InputFileError, match="no measurement is so large"):
        read_columns(path, wanted)


def write_dataset(folder: Path, runs: list[Columns]) -> Path:
    """A LeRobot dataset of version 3: all episodes in one file, names in meta/info.json."""
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": ["pan.pos", "lift.pos"]},
        "observation.effort": {
            "dtype": "float32",
            "shape": [2],
            "names": {"motors": ["pan", "lift"]},
        },
    }
    information = {"codebase_version": "v3.0", "fps": 100, "features": features}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(information))
    path = folder / "data" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    state = np.vstack([np.stack([run["q1"], run["q2"]], axis=1) for run in runs])
    effort = np.vstack([np.stack([run["tau1"], run["tau2"]], axis=1) for run in runs])
    table = {
        "observation.state": arrow.array(state.tolist(), arrow.list_(arrow.float64(), 2)),
        "observation.effort": arrow.array(effort.tolist(), arrow.list_(arrow.float64())),
        "timestamp": np.concatenate([run["t"] for run in runs]),
        "episode_index": np.repeat(np.arange(len(runs)), [len(run["t"]) for run in runs]),
    }
    parquet.write_table(arrow.table(table), path)
    return path


STATE = signals(
    "timestamp",
    ("observation.state[pan.pos]", "observation.state[1]"),
    ("observation.effort[pan]", "observation.effort[lift]"),
)


def test_episodes_of_a_lerobot_dataset_are_read(tmp_path: Path) -> None:
    first, second = short(), {name: values[:70] * 0.5 for name, values in short().items()}
    path = write_dataset(tmp_path / "set", [first, second])
    for number, run in enumerate((first, second)):
        found = read_columns(f"{path}#{number}", STATE)
        np.testing.assert_array_equal(found["timestamp"], run["t"])
        np.testing.assert_array_equal(found["observation.state[pan.pos]"], run["q1"])
        np.testing.assert_array_equal(found["observation.state[1]"], run["q2"])
        np.testing.assert_array_equal(found["observation.effort[lift]"], run["tau2"])


def test_episodes_of_one_file_are_runs_of_one_set() -> None:
    names = [
        RunEntry(file=file, role="train", session_time=None, number=0, temperature=None).name
        for file in ("data/file-000.parquet#0", "data/file-000.parquet#12", "data/file-000.parquet")
    ]
    assert names == ["file-000_0", "file-000_12", "file-000"]


def test_missing_entries_of_a_lerobot_dataset_are_named(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "set", [short(), short()])
    for file, words in ((f"{path}", "episodes 0 to 1"), (f"{path}#7", "no episode 7"),
                        (f"{path}#x", "is no episode")):  # fmt: skip
        with pytest.raises(InputFileError, match=words):
            read_columns(file, STATE)
    with pytest.raises(InputFileError, match=r"no entry 'elbow'.*pan.pos"):
        read_columns(f"{path}#0", signals("timestamp", ("observation.state[elbow]", ""), ("", "")))
    with pytest.raises(InputFileError, match=r"Name an entry: observation.state\[0\]"):
        read_columns(f"{path}#0", signals("timestamp", ("observation.state", ""), ("", "")))


def test_file_with_one_episode_needs_no_number(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "set", [short()])
    assert len(read_columns(path, STATE)["timestamp"]) == len(short()["t"])
