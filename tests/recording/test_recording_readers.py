"""The same run in every format: written by the libraries themselves, read back."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_sets import Columns, motion

from stiffopt.errors import InputError, InputFileError
from stiffopt.recording.readers import read
from stiffopt.recording.readers.read import read_columns
from stiffopt.recording.signals import Signals

PLAIN = Signals(
    time="t",
    position=("q1", "q2"),
    velocity=("qd1", "qd2"),
    link_position=("ql1", ""),
    torque=("tau1", "tau2"),
)
JOINTS = Signals(
    time="",
    position=("/joint_states.position[swing]", "/joint_states.position[slide]"),
    velocity=("/joint_states.velocity[0]", "/joint_states.velocity[1]"),
    link_position=None,
    torque=("/joint_states.effort[swing]", "/joint_states.effort[slide]"),
)
BEGIN = 1_700_000_000


def short() -> Columns:
    return motion(rate=100.0, duration=1.0)


def same(found: Columns, run: Columns, signals: Signals = PLAIN) -> None:
    assert set(found) == {signals.time, *signals.wanted}
    for name, values in found.items():
        np.testing.assert_array_equal(values, run[name])


def write_csv(path: Path, run: Columns, mark: str = ",", head: str = "") -> None:
    lines = [head + mark.join(run)]
    lines += [mark.join(repr(float(v)) for v in row) for row in zip(*run.values(), strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def test_npz_is_read_exactly(tmp_path: Path) -> None:
    run = short()
    np.savez(tmp_path / "run.npz", **run, unused=np.zeros(3))
    same(read_columns(tmp_path / "run.npz", PLAIN), run)


@pytest.mark.parametrize(("mark", "head"), [(",", ""), (";", ""), ("\t", "# "), (",", "﻿")])
def test_csv_is_read_exactly(tmp_path: Path, mark: str, head: str) -> None:
    run = {"label": np.arange(100.0), **short()}
    write_csv(tmp_path / "run.csv", run, mark, head)
    same(read_columns(tmp_path / "run.csv", PLAIN), run)


def test_csv_empty_cells_are_missing_samples(tmp_path: Path) -> None:
    run = short()
    write_csv(tmp_path / "run.csv", run)
    lines = (tmp_path / "run.csv").read_text().splitlines()
    cells = lines[8].split(",")
    cells[list(run).index("tau2")] = ""
    lines[8] = ",".join(cells)
    (tmp_path / "run.csv").write_text("\n".join(lines))
    found = read_columns(tmp_path / "run.csv", PLAIN)
    assert np.flatnonzero(np.isnan(found["tau2"])).tolist() == [7]
    assert np.isfinite(found["tau1"]).all()


def test_parquet_is_read_exactly_with_time_stamps(tmp_path: Path) -> None:
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    run = short()
    parquet.write_table(arrow.table(run), tmp_path / "run.parquet")
    same(read_columns(tmp_path / "run.parquet", PLAIN), run)
    stamps = np.datetime64("2024-05-01T10:00:00", "ns") + (run["t"] * 1e9).astype("m8[ns]")
    parquet.write_table(arrow.table({**run, "t": stamps}), tmp_path / "stamped.parquet")
    np.testing.assert_allclose(
        read_columns(tmp_path / "stamped.parquet", PLAIN)["t"], run["t"], atol=2e-9
    )


def write_bag(folder: Path, run: Columns, *, sqlite: bool, others: bool = True) -> None:
    """A rosbag2 of joint states with a gripper on the same topic, and a slower wrench topic."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = {name.rsplit("/", 1)[1]: item for name, item in store.types.items()}
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer(folder, version=9, storage_plugin=plugin) as bag:
        topics = {
            "/joint_states": "sensor_msgs/msg/JointState",
            "/force": "geometry_msgs/msg/WrenchStamped",
        }
        lines = {
            topic: bag.add_connection(topic, name, typestore=store)
            for topic, name in topics.items()
        }

        def write(topic: str, t: float, message: Any, late: int = 3_000_000) -> None:
            at = BEGIN * 10**9 + round(t * 1e9)
            bag.write(lines[topic], at + late, store.serialize_cdr(message, topics[topic]))

        def header(t: float) -> Any:
            ns = BEGIN * 10**9 + round(t * 1e9)
            stamp = kind["Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            return kind["Header"](stamp=stamp, frame_id="")

        for k, t in enumerate(run["t"]):
            if others and k % 3 == 0:
                gripper = kind["JointState"](
                    header(t), ["finger"], np.array([0.1]), np.array([0.0]), np.array([5.0])
                )
                write("/joint_states", t, gripper, late=1_000_000)
            names = ["swing", "slide"]
            row = [np.array([run[f"{n}{j}"][k] for j in (1, 2)]) for n in ("q", "qd", "tau")]
            write("/joint_states", t, kind["JointState"](header(t), names, *row))
            if k % 4 == 0:
                vector = kind["Vector3"](x=run["ql1"][k], y=2.0 * t, z=0.0)
                wrench = kind["Wrench"](force=vector, torque=vector)
                write("/force", t, kind["WrenchStamped"](header(t), wrench))


def check_joint_states(found: Columns, run: Columns) -> None:
    np.testing.assert_allclose(found[""], run["t"] - run["t"][0], atol=2e-9)
    for names, key in ((JOINTS.position, "q"), (JOINTS.velocity, "qd"), (JOINTS.torque, "tau")):
        for j, name in enumerate(names or ()):
            np.testing.assert_array_equal(found[name], run[f"{key}{j + 1}"])


@pytest.mark.parametrize("sqlite", [True, False])
def test_rosbag2_by_name_and_by_header_stamp(tmp_path: Path, sqlite: bool) -> None:
    # By number, the gripper's messages on the topic would be mixed in.
    signals = Signals(
        time="",
        position=JOINTS.position,
        velocity=("/joint_states.velocity[swing]", "/joint_states.velocity[slide]"),
        link_position=None,
        torque=JOINTS.torque,
    )
    run = short()
    write_bag(tmp_path / "bag", run, sqlite=sqlite)
    found = read_columns(tmp_path / "bag", signals)
    np.testing.assert_allclose(found[""], run["t"], atol=2e-9)
    np.testing.assert_array_equal(found["/joint_states.effort[slide]"], run["tau2"])
    np.testing.assert_array_equal(found["/joint_states.velocity[swing]"], run["qd1"])
    if sqlite:
        storage = next((tmp_path / "bag").glob("*.db3"))
        np.testing.assert_array_equal(
            read_columns(storage, signals)["/joint_states.position[swing]"], run["q1"]
        )


def test_rosbag2_resamples_topics_to_the_joint_clock(tmp_path: Path) -> None:
    run = short()
    write_bag(tmp_path / "bag", run, sqlite=True, others=False)
    signals = Signals(
        time="t",
        position=JOINTS.position,
        velocity=None,
        link_position=("/force.wrench.force.y", ""),
        torque=JOINTS.torque,
    )
    found = read_columns(tmp_path / "bag", signals)["/force.wrench.force.y"]
    last = 96
    np.testing.assert_allclose(found[: last + 1], 2.0 * run["t"][: last + 1], atol=1e-8)
    assert np.isnan(found[last + 1 :]).all()


def test_mcap_of_ros2_messages(tmp_path: Path) -> None:
    from mcap_ros2.writer import Writer

    run = short()
    definition = (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
        "float64[] effort\n" + "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n"
        "string frame_id\n" + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\n"
        "uint32 nanosec\n"
    )
    with (tmp_path / "run.mcap").open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", definition)
        for k, t in enumerate(run["t"]):
            ns = BEGIN * 10**9 + round(t * 1e9)
            message = {
                "header": {
                    "stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9},
                    "frame_id": "",
                },
                "name": ["swing", "slide"],
                "position": [run["q1"][k], run["q2"][k]],
                "velocity": [run["qd1"][k], run["qd2"][k]],
                "effort": [run["tau1"][k], run["tau2"][k]],
            }
            writer.write_message("/joint_states", schema, message, log_time=ns + 2_000_000)
        writer.finish()
    check_joint_states(read_columns(tmp_path / "run.mcap", JOINTS), run)


def write_json_mcap(path: Path, run: Columns, encoding: str = "json") -> None:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("state", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/joint_states", encoding, schema)
        for k, t in enumerate(run["t"]):
            message = {
                "time": t + 5.0,
                "name": ["swing", "slide"],
                "position": [run["q1"][k], run["q2"][k]],
                "velocity": [run["qd1"][k], run["qd2"][k]],
                "effort": [run["tau1"][k], run["tau2"][k]],
            }
            ns = round(t * 1e9)
            writer.add_message(channel, ns, json.dumps(message).encode(), ns)
        writer.finish()


def test_mcap_of_json_messages_with_the_log_time(tmp_path: Path) -> None:
    run = short()
    write_json_mcap(tmp_path / "run.mcap", run)
    check_joint_states(read_columns(tmp_path / "run.mcap", JOINTS), run)


def test_mcap_with_a_time_field_of_its_own(tmp_path: Path) -> None:
    run = short()
    write_json_mcap(tmp_path / "run.mcap", run)
    signals = Signals(
        time="/joint_states.time",
        position=JOINTS.position,
        velocity=None,
        link_position=None,
        torque=JOINTS.torque,
    )
    found = read_columns(tmp_path / "run.mcap", signals)["/joint_states.time"]
    np.testing.assert_allclose(found, run["t"] + 5.0, atol=1e-12)


def edited(name: str) -> Signals:
    return Signals(
        time="",
        position=("/joint_states.position[swing]", name),
        velocity=None,
        link_position=None,
        torque=JOINTS.torque,
    )


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("/joint_state.position[1]", "no topic '/joint_state'.*mean '/joint_states'"),
        ("/joint_states", "names no field"),
        ("/joint_states.position[elbow]", r"no message on /joint_states has .*elbow"),
        ("/joint_states.position[7]", r"has /joint_states.position\[7\]\. Correct"),
        ("/joint_states.angle[1]", r"has /joint_states.angle\[1\]\. Correct"),
    ],
)
def test_wrong_message_fields_are_named(tmp_path: Path, name: str, says: str) -> None:
    write_json_mcap(tmp_path / "run.mcap", short())
    with pytest.raises(InputFileError, match=says):
        read_columns(tmp_path / "run.mcap", edited(name))


def test_unknown_encodings_and_broken_files_are_refused(tmp_path: Path) -> None:
    write_json_mcap(tmp_path / "run.mcap", short(), encoding="protobuf")
    with pytest.raises(InputFileError, match="'protobuf'; allowed are cdr"):
        read_columns(tmp_path / "run.mcap", JOINTS)
    for name in ("bad.mcap", "bad.npz", "bad.parquet"):
        (tmp_path / name).write_bytes(b"not what the ending says" * 20)
        with pytest.raises(InputFileError, match=name):
            read_columns(tmp_path / name, PLAIN if name != "bad.mcap" else JOINTS)
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    with pytest.raises(InputFileError, match="cannot be read as a rosbag2"):
        read_columns(tmp_path / "bag", JOINTS)
    (tmp_path / "lone.db3").write_bytes(b"")
    with pytest.raises(InputFileError, match=r"needs its metadata\.yaml"):
        read_columns(tmp_path / "lone.db3", JOINTS)


@pytest.mark.parametrize("name", ["run.csv", "run.npz", "run.parquet"])
def test_missing_column_suggests_the_nearest(tmp_path: Path, name: str) -> None:
    run = short()
    run["tau_1"] = run.pop("tau1")
    write = {
        "run.csv": write_csv,
        "run.npz": lambda path, data: np.savez(path, **data),
        "run.parquet": _write_parquet,
    }[name]
    write(tmp_path / name, run)
    with pytest.raises(InputFileError, match=r"no column 'tau1'.*Did you mean 'tau_1'"):
        read_columns(tmp_path / name, PLAIN)


def _write_parquet(path: Path, run: Columns) -> None:
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    parquet.write_table(arrow.table(run), path)


def test_content_that_is_no_table_of_numbers_is_refused(tmp_path: Path) -> None:
    run = short()
    np.savez(tmp_path / "shape.npz", **{**run, "q1": np.zeros((100, 2))})
    with pytest.raises(InputFileError, match=r"shape.npz, q1: needs a list of numbers"):
        read_columns(tmp_path / "shape.npz", PLAIN)
    np.savez(tmp_path / "length.npz", **{**run, "q1": np.zeros(7)})
    with pytest.raises(InputFileError, match=r"unequal lengths: .*q1: 7"):
        read_columns(tmp_path / "length.npz", PLAIN)
    write_csv(tmp_path / "word.csv", run)
    text = (tmp_path / "word.csv").read_text().splitlines()
    text[5] = text[5].replace(text[5].split(",")[1], "high", 1)
    (tmp_path / "word.csv").write_text("\n".join(text))
    with pytest.raises(InputFileError, match=r"row 5, q1: 'high' is no number"):
        read_columns(tmp_path / "word.csv", PLAIN)
    (tmp_path / "run.xyz").write_text("")
    with pytest.raises(InputFileError, match=r"'.xyz' is none of .csv"):
        read_columns(tmp_path / "run.xyz", PLAIN)
    write_csv(tmp_path / "run.csv", run)
    with pytest.raises(InputFileError, match=r"signals.time is required"):
        read_columns(tmp_path / "run.csv", JOINTS)


def test_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> Callable[..., None]:
        raise ModuleNotFoundError(f"No module named {name!r}", name="mcap")

    (tmp_path / "run.mcap").write_bytes(b"")
    monkeypatch.setattr(read, "import_module", absent)
    with pytest.raises(InputError, match=r"'mcap'.*pip install 'stiffopt\[recordings\]'"):
        read_columns(tmp_path / "run.mcap", JOINTS)


def test_implausibly_large_numbers_are_refused(tmp_path: Path) -> None:
    """Bytes that were lost or shifted; their squares would be infinite."""
    run = short()
    run["q2"][30] = -1.7e274
    np.savez(tmp_path / "run.npz", **run)
    with pytest.raises(InputFileError, match=r"q2: holds -1.7e\+274 in row 31: no measurement"):
        read_columns(tmp_path / "run.npz", PLAIN)
