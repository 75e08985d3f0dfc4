"""Files of recorded runs, one sound run of each format that is read."""

from __future__ import annotations

import functools
import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reliability import mutators
from benchmarks.reliability.subject import CHECK, RECORDED, Subject, write_csv

Arrays = dict[str, np.ndarray]

_SET = """
schema = 1
name = "{name}"
robot = "robot.urdf"
joints = ["joint1", "joint2"]

[signals]
time = "{time}"
position = [{position}]
{velocity}
torque = [{torque}]

[[runs]]
file = "{run}"
role = "train"

[[runs]]
file = "{test}"
role = "test"
"""
_ROWS = 400


def run_files(place: Path) -> Iterator[Subject]:
    """Run files of every format, laid out below `place`."""
    with np.load(RECORDED / "train_1.npz") as archive:
        arrays = {name: archive[name][:_ROWS] for name in archive.files}
    with np.load(RECORDED / "test_1.npz") as archive:
        others = {name: archive[name][:_ROWS] for name in archive.files}
    yield from _tables(place, arrays, others)
    yield from _messages(place, arrays, others)
    yield from _of_robots(place, arrays, others)


def _opened(path: Path) -> object:
    from stiffopt.recording.recording_set import load_recordings

    (folder,) = (each for each in path.parents[:5] if (each / "recordings.toml").is_file())
    recordings = load_recordings(folder)
    return [recordings.open(entry) for entry in recordings.runs]


def _begin(folder: Path) -> Path:
    folder.mkdir()
    shutil.copy(RECORDED / "robot.urdf", folder)
    return folder


def _tables(place: Path, arrays: Arrays, others: Arrays) -> Iterator[Subject]:
    text = (RECORDED / "recordings.toml").read_text()
    head = text[: text.index("[[runs]]")]
    diagnose = ("diagnose", ".", "--out", "../out", "--quiet", "--no-report", "--no-experiment")
    for kind, write, spoil, command in (
        ("csv", write_csv, mutators.spoiled_csv, diagnose),
        ("npz", _npz, mutators.spoiled_npz, CHECK),
        ("parquet", _parquet, mutators.spoiled_bytes, CHECK),
    ):
        folder = _begin(place / kind)
        runs = [(f"run.{kind}", "train"), (f"test.{kind}", "test")]
        (folder / "recordings.toml").write_text(
            head + "".join(f'[[runs]]\nfile = "{file}"\nrole = "{role}"\n' for file, role in runs)
        )
        write(folder / f"run.{kind}", arrays)
        write(folder / f"test.{kind}", others)
        yield Subject(kind, folder, f"run.{kind}", spoil, _opened, command)


def _messages(place: Path, arrays: Arrays, others: Arrays) -> Iterator[Subject]:
    def described(run: str, test: str) -> str:
        return _SET.format(
            name="messages",
            time="",
            position='"/joint_states.position[joint1]", "/joint_states.position[joint2]"',
            velocity='velocity = ["/joint_states.velocity[0]", "/joint_states.velocity[1]"]',
            torque='"/joint_states.effort[0]", "/joint_states.effort[1]"',
            run=run,
            test=test,
        )

    spoil = mutators.spoiled_bytes
    for kind, sqlite in (("bag of SQLite", True), ("bag of MCAP", False)):
        folder = _begin(place / kind.replace(" ", "_"))
        (folder / "recordings.toml").write_text(described("bag", "test"))
        storage = _bag(folder / "bag", arrays, sqlite)
        data = f"bag/{storage}"
        _bag(folder / "test", others, sqlite)
        yield Subject(kind, folder, data, spoil, _opened, CHECK)
        text = mutators.spoiled_text
        yield Subject(f"{kind}, metadata", folder, "bag/metadata.yaml", text, _opened, CHECK)
        if not sqlite:
            alone = place / "mcap"
            shutil.copytree(folder, alone)
            shutil.copy(folder / data, alone / "run.mcap")
            (alone / "recordings.toml").write_text(described("run.mcap", "test"))
            yield Subject("mcap", alone, "run.mcap", spoil, _opened, CHECK)
            spoken = place / "mcap_of_json"
            shutil.copytree(folder, spoken)
            (spoken / "recordings.toml").write_text(described("run.mcap", "test"))
            sound = mutators.messages_of({name: each[:200] for name, each in arrays.items()})
            step = float(arrays["t"][1] - arrays["t"][0])
            (spoken / "run.mcap").write_bytes(mutators.mcap_of_json(sound, step))
            one = functools.partial(_spoiled_messages, sound, step)
            yield Subject("mcap of JSON", spoken, "run.mcap", one, _opened, CHECK)


def _spoiled_messages(
    sound: list[dict[str, Any]], step: float, _: bytes, choice: random.Random
) -> bytes:
    return mutators.spoiled_json(sound, step, choice)


def _of_robots(place: Path, arrays: Arrays, others: Arrays) -> Iterator[Subject]:
    """LeRobot datasets and traces of KUKA controllers."""
    folder = _begin(place / "lerobot")
    file = _dataset(folder, [arrays, others])
    (folder / "recordings.toml").write_text(
        _SET.format(
            name="episodes",
            time="timestamp",
            position='"observation.state[pan]", "observation.state[1]"',
            velocity="",
            torque='"observation.effort[0]", "observation.effort[lift]"',
            run=f"{file}#0",
            test=f"{file}#1",
        )
    )
    yield Subject("lerobot", folder, file, mutators.spoiled_bytes, _opened, CHECK)
    rows = mutators.spoiled_parquet
    yield Subject("lerobot, rows", folder, file, rows, _opened, CHECK)
    names = "meta/info.json"
    json_of = mutators.spoiled_document
    yield Subject("lerobot, names", folder, names, json_of, _opened, CHECK)
    folder = _begin(place / "kuka")
    for run, columns in (("run", arrays), ("test", others)):
        _trace(folder / f"{run}_KRCIpo.dat", columns)
    (folder / "recordings.toml").write_text(
        _SET.format(
            name="trace",
            time="t",
            position='"q1", "q2"',
            velocity='velocity = ["qd1", "qd2"]',
            torque='"tau1", "tau2"',
            run="run_KRCIpo.dat",
            test="test_KRCIpo.dat",
        )
    )
    header = "run_KRCIpo.dat"
    yield Subject("kuka", folder, header, mutators.spoiled_header, _opened, CHECK)
    yield Subject("kuka, values", folder, "run_KRCIpo.r64", mutators.spoiled_bytes,
                  lambda path: _opened(path.with_suffix(".dat")), CHECK)  # fmt: skip


def _npz(path: Path, arrays: Arrays) -> None:
    np.savez_compressed(path, **arrays)


def _parquet(path: Path, arrays: Arrays) -> None:
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    parquet.write_table(arrow.table(arrays), path)


def _dataset(folder: Path, runs: list[Arrays]) -> str:
    """Write a LeRobot dataset of two joints; return the place of its episodes."""
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": ["pan", "lift"]},
        "observation.effort": {"dtype": "float32", "shape": [2], "names": {"m": ["pan", "lift"]}},
    }
    (folder / "meta").mkdir()
    document = {"codebase_version": "v3.0", "fps": 200, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(document))
    file = "data/file-000.parquet"
    (folder / "data").mkdir()
    pairs = {"observation.state": ("q1", "q2"), "observation.effort": ("tau1", "tau2")}
    table: dict[str, object] = {
        name: np.vstack([np.stack([run[a], run[b]], axis=1) for run in runs]).tolist()
        for name, (a, b) in pairs.items()
    }
    table["timestamp"] = np.concatenate([run["t"] for run in runs])
    table["episode_index"] = np.repeat(np.arange(len(runs)), [len(run["t"]) for run in runs])
    parquet.write_table(arrow.table(table), folder / file)
    return file


def _trace(path: Path, arrays: Arrays) -> None:
    """A KUKA trace: header of channels, values beside it."""
    names = ("q1", "q2", "qd1", "qd2", "tau1", "tau2")
    step = float(arrays["t"][1] - arrays["t"][0])
    lines = ["#BEGINCHANNELHEADER", "200,Zeit", "210,IMPLIZIT", f"241,{step!r}",
             "#ENDCHANNELHEADER"]  # fmt: skip
    for column, name in enumerate(names, start=1):
        lines += ["#BEGINCHANNELHEADER", f"200,{name}", "210,EXPLIZIT", "214,REAL64",
                  f"220,{len(arrays[name])}", f"221,{column}", "240,0", "241,1",
                  "#ENDCHANNELHEADER"]  # fmt: skip
    path.write_text("\r\n".join(lines) + "\r\n", encoding="latin-1")
    table = np.stack([arrays[name] for name in names], axis=1)
    table.astype("<f8").tofile(path.with_suffix(".r64"))


def _bag(folder: Path, arrays: Arrays, sqlite: bool) -> str:
    """Write a bag; return the name of its storage file."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    types = store.types
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        kind = "sensor_msgs/msg/JointState"
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for k, now in enumerate(arrays["t"]):
            stamp = types["builtin_interfaces/msg/Time"](sec=int(now), nanosec=int(now % 1 * 1e9))
            message = types[kind](
                header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
                name=["joint1", "joint2"],
                position=np.array([arrays["q1"][k], arrays["q2"][k]]),
                velocity=np.array([arrays["qd1"][k], arrays["qd2"][k]]),
                effort=np.array([arrays["tau1"][k], arrays["tau2"][k]]),
            )
            data = store.serialize_cdr(message, kind)
            writer.write(connection, int(now * 1e9), data)
    return next(p.name for p in folder.iterdir() if p.suffix in (".db3", ".mcap"))
