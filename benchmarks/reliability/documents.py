"""Documents that people write: problems, studies, sweeps, robots, sets; what init begins with."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.reliability import mutators
from benchmarks.reliability.commands import ROOT
from benchmarks.reliability.subject import CHECK, RECORDED, Subject, write_csv

POSES = ("q1", "q2", "fx", "fy", "fz", "dx", "dy", "dz")
# As a diagnosis of the shipped set writes it.
_EXTENDED = (Path(__file__).parent / "extended.toml").read_text()
_SWEEP = """schema = 1
kind = "sweep"
base = "small.toml"
title = "two durations"
[grid]
"motion.duration" = ["1 s", "2 s"]
"""
_CATALOGUE = """schema = 1
kind = "catalogue"
[[reducer]]
name = "own"
ratio = 100
K1 = 1e4
K2 = 2e4
K3 = 3e4
T1 = 5.0
T2 = 20.0
ratings = [20.0, 50.0, 90.0]
[[bolt]]
size = "K5"
diameter = "5 mm"
pitch = "0.8 mm"
head_diameter = "8.5 mm"
bearing_diameter = "8.03 mm"
hole = "5.5 mm"
[[key]]
width = "5 mm"
height = "4 mm"
shaft_min = "12 mm"
shaft_max = "17 mm"
shaft_depth = "2.5 mm"
hub_depth = "1.9 mm"
shaft_flank_height = "2.2 mm"
hub_flank_height = "1.5 mm"
[[belt]]
name = "AT7"
pitch = "7 mm"
tooth_height = "1.9 mm"
tooth_root_width = "3.4 mm"
flank_angle = "25 deg"
tooth_modulus = "80 MPa"
span_stiffness = { "10e-3" = 2e5 }
[[surface]]
name = "ground"
first = "steel"
second = "aluminium"
fractal_dimension = 2.5
fractal_roughness = 2e-9
friction = 0.14
"""


def static_toml(name: str, joints: tuple[str, str]) -> str:
    """Text of a static.toml of two joints, whose poses stand in `poses.csv` as `POSES` says."""
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


def documents(place: Path) -> Iterator[Subject]:
    """Problems, studies, sweeps and robots, laid out below `place`."""
    from stiffopt.discovery.extended.model import load_extended
    from stiffopt.files import read_table
    from stiffopt.preload.files import load_study
    from stiffopt.problem.files import load_problem
    from stiffopt.problem.resolve import resolve
    from stiffopt.robot.files import load_robot
    from stiffopt.sweep.cases import load_sweep

    shared = place / "problems"
    shutil.copytree(ROOT / "problems", shared, ignore=shutil.ignore_patterns("recordings"))
    shutil.copytree(ROOT / "stiffopt/robot/data", place / "stiffopt/robot/data")
    small = (shared / "two_link.toml").read_text()
    quick = "intervals = 8\ntime_limit = 3\nmax_iterations = 20\n"
    (shared / "small.toml").write_text(small.replace("intervals = 20\n", quick))

    def solved(path: Path) -> object:
        return resolve(load_problem(path).problem)

    out = ("--out", "out", "--quiet")
    toml = mutators.spoiled_toml
    yield Subject("problem", shared, "small.toml", toml, solved, ("solve", "small.toml", *out))
    for name in ("er3a_pick_and_place", "er3a_process_force", "ur10_fixed_path"):
        file = f"{name}.toml"
        modes, solve = ("modes", file), ("solve", file, *out)
        command = modes if name == "er3a_pick_and_place" else solve
        yield Subject(name, shared, file, toml, load_problem, command, whole=False)
    for name in ("er3a_preload_all_bolts", "er3a_preload_pins", "er3a_preload_wrench"):
        file = f"{name}.toml"
        yield Subject(name, shared, file, toml, load_study, ("preload", file, *out), whole=False)
    (shared / "sweep.toml").write_text(_SWEEP)
    command = ("sweep", "sweep.toml", *out, "--workers", "1")
    yield Subject("sweep", shared, "sweep.toml", toml, load_sweep, command, whole=False)
    stiffness = ("stiffness", "two_link_robot.toml", "--out", "out")
    yield Subject("robot", shared, "two_link_robot.toml", toml, load_robot, stiffness)
    urdf = mutators.spoiled_urdf
    command = ("stiffness", "two_link_robot.toml", "--out", "out")
    yield Subject("urdf", shared, "two_link.urdf", urdf, load_robot, command)
    contact = place / "contact"
    shutil.copytree(ROOT / "stiffopt/robot/data/er3a_c60_contact", contact)
    shutil.copytree(ROOT / "stiffopt/robot/data/er3a_c60", place / "er3a_c60")
    command = ("stiffness", "robot.toml", "--out", "out")
    yield Subject("contacts", contact, "robot.toml", toml, load_robot, command)
    (shared / "extended.toml").write_text(_EXTENDED)
    shutil.copytree(RECORDED, shared / "set")
    own = (shared / "small.toml").read_text().replace("two_link_robot.toml", "set/robot.urdf")
    (shared / "recorded.toml").write_text(own)
    command = ("solve", "recorded.toml", *out, "--model", "extended.toml")
    yield Subject("extended", shared, "extended.toml", toml, load_extended, command, whole=False)
    table = "t,q1\n" + "".join(f"{k},{k}\n" for k in range(20))
    (shared / "table.csv").write_text(table)
    csv = mutators.spoiled_csv
    yield Subject("table", shared, "table.csv", csv, lambda p: read_table(p, ["t", "q1"]), ())


def sets(place: Path) -> Iterator[Subject]:
    """Recording sets as documents: recordings.toml, static.toml, their URDF and poses."""
    from stiffopt.recording.recording_set import load_recordings
    from stiffopt.recording.static_set import load_static_set

    recorded = place / "set"
    shutil.copytree(RECORDED, recorded)
    toml, urdf = mutators.spoiled_toml, mutators.spoiled_urdf
    yield Subject("recordings", recorded, "recordings.toml", toml, load_recordings, CHECK)
    found = ("diagnose", ".", "--out", "../out", "--quiet", "--no-report", "--no-experiment")
    yield Subject("diagnosed", recorded, "recordings.toml", toml, load_recordings, found)
    set_of = lambda path: load_recordings(path.parent)  # noqa: E731
    yield Subject("set's urdf", recorded, "robot.urdf", urdf, set_of, CHECK)
    static = place / "static"
    static.mkdir()
    shutil.copy(RECORDED / "robot.urdf", static)
    (static / "static.toml").write_text(static_toml("static", ("joint1", "joint2")))
    usual = np.array([1.0, 0.5, 0.0, 0.0, 99.0, 0.0, 0.0, 0.0])
    poses = usual + np.random.default_rng(1).normal(scale=1e-3, size=(12, 8))
    write_csv(static / "poses.csv", dict(zip(POSES, poses.T, strict=True)))
    identify = ("identify-stiffness", ".", "--out", "../out")
    yield Subject("static", static, "static.toml", toml, load_static_set, identify)
    csv = mutators.spoiled_csv
    poses_of = lambda path: load_static_set(path.parent)  # noqa: E731
    yield Subject("poses", static, "poses.csv", csv, poses_of, identify)


def begun(place: Path) -> Iterator[Subject]:
    """What `stiffopt init` begins with, and one's own catalogue."""
    from stiffopt.recording.readers.read import read_tables
    from stiffopt.robot.files import load_robot
    from stiffopt.robot.own_catalogue import read_own_catalogue
    from stiffopt.starter.guessing import guess_columns
    from stiffopt.starter.problem_file import problem_text
    from stiffopt.starter.robot_file import robot_text

    begun = place / "begun"
    begun.mkdir()
    shutil.copy(ROOT / "stiffopt/robot/data/ur10/robot.urdf", begun / "arm.urdf")

    def started(path: Path) -> object:
        own = path.with_name("own.toml")
        own.write_text(robot_text(path, path.parent).text)
        return problem_text(load_robot(own), own, path.parent)

    urdf, toml = mutators.spoiled_urdf, mutators.spoiled_toml
    command = ("init", "robot", "arm.urdf", "--out", "out/robot.toml")
    yield Subject("own urdf", begun, "arm.urdf", urdf, started, command)
    command = ("init", "problem", "arm.urdf", "--out", "out/problem.toml")
    yield Subject("own problem", begun, "arm.urdf", urdf, load_robot, command)
    shutil.copy(RECORDED / "robot.urdf", begun / "two.urdf")
    two = load_robot(begun / "two.urdf")
    time = np.arange(0.0, 14.0, 0.01)
    first, second = np.sin(time / 0.4), 0.5 * np.sin(time / 0.7)
    columns = {
        "t [s]": time, "q1": first, "q2": second, "tau1": 9.0 * first, "tau2": np.cos(time),
    }  # fmt: skip
    write_csv(begun / "log.csv", columns)
    command = ("init", "recording", "log.csv", "--urdf", "two.urdf", "--out", "out")
    guessed = lambda path: guess_columns(read_tables(path)[""], two)  # noqa: E731
    yield Subject("own table", begun, "log.csv", mutators.spoiled_csv, guessed, command)
    (begun / "reducers.toml").write_text(_CATALOGUE)
    command = ("catalogue", "reducers", "--own", "reducers.toml")
    yield Subject("own catalogue", begun, "reducers.toml", toml, read_own_catalogue, command)
