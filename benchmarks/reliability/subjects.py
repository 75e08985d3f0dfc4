"""What is spoiled, and what then reads it: small sound files of every kind with their loaders."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reliability import mutators
from benchmarks.reliability.commands import ROOT

_SET = ROOT / "problems" / "recordings" / "two_link_friction"
_MESSAGES = """
schema = 1
name = "messages"
robot = "robot.urdf"
joints = ["joint1", "joint2"]

[signals]
time = ""
position = ["/joint_states.position[joint1]", "/joint_states.position[joint2]"]
velocity = ["/joint_states.velocity[0]", "/joint_states.velocity[1]"]
torque = ["/joint_states.effort[0]", "/joint_states.effort[1]"]

[[runs]]
file = "RUN"
role = "train"
"""

_POSES = ("q1", "q2", "fx", "fy", "fz", "dx", "dy", "dz")
# As a diagnosis of the shipped set writes it.
_EXTENDED = (Path(__file__).parent / "extended.toml").read_text()


def static_toml(name: str, joints: tuple[str, str]) -> str:
    """Text of a static.toml of two joints, whose poses stand in `poses.csv` as `_POSES` says."""
    first, second = joints
    return f"""schema = 1
kind = "static"
name = "{name}"
robot = "robot.urdf"
joints = ["{first}", "{second}"]
tool_frame = "tool0"
poses = "poses.csv"
position = ["q1", "q2"]
force = ["fx", "fy", "fz"]
displacement = ["dx", "dy", "dz"]
difference = true
"""


@dataclass(frozen=True)
class Subject:
    """A kind of file.

    Parameters
    ----------
    kind : str
    folder : Path
        With the file and all that it needs.
    file : str
        That is spoiled.
    spoil : callable
    read : callable
        The loader, with the file's path.
    command : tuple of str
        The same by the command line, in the folder.
    """

    kind: str
    folder: Path
    file: str
    spoil: Callable[[bytes, random.Random], bytes]
    read: Callable[[Path], Any]
    command: tuple[str, ...]

    def spoiled(self, content: bytes, seed: int) -> bytes:
        """The sound content, spoiled by that seed."""
        return self.spoil(content, random.Random(f"{self.kind} {seed}"))


def subjects(place: Path) -> list[Subject]:
    """Every kind, laid out below `place`."""
    return [*_documents(place), *_runs(place), *_begun(place)]


def _documents(place: Path) -> Iterator[Subject]:
    from stiffopt.discovery.extended.model import load_extended
    from stiffopt.files import read_table
    from stiffopt.preload.files import load_study
    from stiffopt.problem.files import load_problem
    from stiffopt.problem.resolve import resolve
    from stiffopt.recording.recording_set import load_recordings
    from stiffopt.recording.static_set import load_static_set
    from stiffopt.robot.files import load_robot

    shared = place / "documents"
    shutil.copytree(ROOT / "problems", shared, ignore=shutil.ignore_patterns("recordings"))
    small = (shared / "two_link.toml").read_text()
    quick = "intervals = 8\ntime_limit = 3\nmax_iterations = 20\n"
    (shared / "small.toml").write_text(small.replace("intervals = 8\n", quick))

    def solved(path: Path) -> object:
        return resolve(load_problem(path).problem)

    out = ("--out", "out", "--quiet")
    toml = mutators.spoiled_toml
    yield Subject("problem", shared, "small.toml", toml, solved, ("solve", "small.toml", *out))
    for name in ("er3a_pick_and_place", "er3a_process_force", "ur10_fixed_path"):
        file = f"{name}.toml"
        yield Subject(name, shared, file, toml, load_problem, ("modes", file))
    for name in ("er3a_preload_all_bolts", "er3a_preload_pins"):
        file = f"{name}.toml"
        yield Subject(name, shared, file, toml, load_study, ("schema", "robot"))
    stiffness = ("stiffness", "two_link_robot.toml", "--out", "out")
    yield Subject("robot", shared, "two_link_robot.toml", toml, load_robot, stiffness)
    urdf = mutators.spoiled_urdf
    yield Subject("urdf", shared, "two_link.urdf", urdf, load_robot, ("stiffness", "two_link.urdf"))
    contact = place / "contact"
    shutil.copytree(ROOT / "stiffopt/robot/data/er3a_c60_contact", contact)
    shutil.copytree(ROOT / "stiffopt/robot/data/er3a_c60", place / "er3a_c60")
    command = ("stiffness", "robot.toml", "--out", "out")
    yield Subject("contacts", contact, "robot.toml", toml, load_robot, command)
    check = ("recording", "check", ".")
    recorded = place / "set"
    shutil.copytree(_SET, recorded)
    yield Subject("recordings", recorded, "recordings.toml", toml, load_recordings, check)
    set_of = lambda path: load_recordings(path.parent)  # noqa: E731
    yield Subject("set's urdf", recorded, "robot.urdf", urdf, set_of, check)
    static = place / "static"
    static.mkdir()
    shutil.copy(_SET / "robot.urdf", static)
    (static / "static.toml").write_text(static_toml("static", ("joint1", "joint2")))
    usual = np.array([1.0, 0.5, 0.0, 0.0, 99.0, 0.0, 0.0, 0.0])
    poses = usual + np.random.default_rng(1).normal(scale=1e-3, size=(12, 8))
    _csv(static / "poses.csv", dict(zip(_POSES, poses.T, strict=True)))
    identify = ("identify-stiffness", ".", "--out", "../out")
    yield Subject("static", static, "static.toml", toml, load_static_set, identify)
    csv = mutators.spoiled_csv
    poses_of = lambda path: load_static_set(path.parent)  # noqa: E731
    yield Subject("poses", static, "poses.csv", csv, poses_of, identify)
    found = place / "extended"
    found.mkdir()
    (found / "extended.toml").write_text(_EXTENDED)
    yield Subject("extended", found, "extended.toml", toml, load_extended, ("schema", "robot"))
    (found / "trajectory.csv").write_text("t,q1\n" + "".join(f"{k},{k}\n" for k in range(20)))
    yield Subject("table", found, "trajectory.csv", csv, lambda p: read_table(p, ["t", "q1"]), ())


def _begun(place: Path) -> Iterator[Subject]:
    """What `stiffopt init` begins with, and one's own catalogue."""
    from stiffopt.robot.files import load_robot
    from stiffopt.robot.own_catalogue import read_own_catalogue
    from stiffopt.starter.guessing import guess
    from stiffopt.starter.problem_file import problem_text
    from stiffopt.starter.robot_file import robot_text
    from stiffopt.starter.tables import read_any_table

    begun = place / "begun"
    begun.mkdir()
    shutil.copy(ROOT / "stiffopt/robot/data/ur10/robot.urdf", begun / "arm.urdf")

    def started(path: Path) -> object:
        own = path.with_name("own.toml")
        own.write_text(robot_text(path, path.parent).text)
        return problem_text(load_robot(own), own, path.parent)

    command = ("init", "robot", "arm.urdf", "--out", "out/robot.toml")
    yield Subject("own urdf", begun, "arm.urdf", mutators.spoiled_urdf, started, command)
    shutil.copy(_SET / "robot.urdf", begun / "two.urdf")
    two = load_robot(begun / "two.urdf")
    time, turn = np.arange(0.0, 5.0, 0.01), np.sin(np.arange(500) / 40.0)
    columns = {"t [s]": time, "q1": turn, "q2": 0.5 * turn, "tau1": 9.0 * turn, "tau2": turn}
    _csv(begun / "log.csv", columns)
    command = ("init", "recording", "log.csv", "--urdf", "two.urdf", "--out", "out")
    guessed = lambda path: guess(read_any_table(path), two)  # noqa: E731
    yield Subject("own table", begun, "log.csv", mutators.spoiled_csv, guessed, command)
    (begun / "reducers.toml").write_text(
        'schema = 1\nkind = "catalogue"\n[[reducer]]\nname = "own"\nratio = 100\nK1 = 1e4\n'
        "K2 = 2e4\nK3 = 3e4\nT1 = 5.0\nT2 = 20.0\nratings = [20.0, 50.0, 90.0]\n"
    )
    command = ("catalogue", "reducers", "--own", "reducers.toml")
    toml = mutators.spoiled_toml
    yield Subject("own catalogue", begun, "reducers.toml", toml, read_own_catalogue, command)


def _runs(place: Path) -> Iterator[Subject]:
    from stiffopt.recording.recording_set import load_recordings

    def opened(path: Path) -> object:
        folder = path if path.is_dir() else path.parent
        folder = folder if (folder / "recordings.toml").is_file() else folder.parent
        recordings = load_recordings(folder)
        return [recordings.open(entry) for entry in recordings.runs]

    check = ("recording", "check", ".")
    with np.load(_SET / "train_1.npz") as archive:
        arrays = {name: archive[name][:120] for name in archive.files}
    for kind, write, spoil in (
        ("csv", _csv, mutators.spoiled_csv),
        ("npz", _npz, mutators.spoiled_npz),
        ("parquet", _parquet, mutators.spoiled_bytes),
    ):
        folder = place / kind
        folder.mkdir()
        shutil.copy(_SET / "robot.urdf", folder)
        text = (_SET / "recordings.toml").read_text()
        head = text[: text.index("[[runs]]")]
        file = f"run.{kind}"
        (folder / "recordings.toml").write_text(
            f'{head}[[runs]]\nfile = "{file}"\nrole = "train"\n'
        )
        write(folder / file, arrays)
        yield Subject(kind, folder, file, spoil, opened, check)
    for kind, sqlite in (("bag of SQLite", True), ("bag of MCAP", False)):
        folder = place / kind.replace(" ", "_")
        folder.mkdir()
        shutil.copy(_SET / "robot.urdf", folder)
        (folder / "recordings.toml").write_text(_MESSAGES.replace("RUN", "bag"))
        storage = _bag(folder / "bag", arrays, sqlite)
        data = f"bag/{storage}"
        yield Subject(kind, folder, data, mutators.spoiled_bytes, opened, check)
        spoil = mutators.spoiled_text
        yield Subject(f"{kind}, metadata", folder, "bag/metadata.yaml", spoil, opened, check)
        if not sqlite:
            alone = place / "mcap"
            shutil.copytree(folder, alone)
            shutil.copy(folder / data, alone / "run.mcap")
            (alone / "recordings.toml").write_text(_MESSAGES.replace("RUN", "run.mcap"))
            yield Subject("mcap", alone, "run.mcap", mutators.spoiled_bytes, opened, check)
            spoken = place / "mcap_of_json"
            shutil.copytree(folder, spoken)
            (spoken / "recordings.toml").write_text(_MESSAGES.replace("RUN", "run.mcap"))
            (spoken / "run.mcap").write_bytes(mutators.mcap_of_json(mutators.json_messages()))
            spoil = mutators.spoiled_json
            yield Subject("mcap of JSON", spoken, "run.mcap", spoil, opened, check)


def _csv(path: Path, arrays: dict[str, np.ndarray]) -> None:
    table = np.column_stack(list(arrays.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(arrays), comments="")


def _npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    np.savez_compressed(path, **arrays)


def _parquet(path: Path, arrays: dict[str, np.ndarray]) -> None:
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    parquet.write_table(arrow.table(arrays), path)


def _bag(folder: Path, arrays: dict[str, np.ndarray], sqlite: bool) -> str:
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
