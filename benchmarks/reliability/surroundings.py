"""Documents on what surrounds a model: cells, how far it may be off, what it left open."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

from benchmarks.reliability import mutators
from benchmarks.reliability.subject import CHECK, RECORDED, Subject

_CELL = """
[cell]
floor = "-200 mm"
clearance = "20 mm"
self_collision = true
link_radius = "40 mm"
[[cell.box]]
name = "box"
size = ["200 mm", "60 mm", "300 mm"]
position = ["2 m", "0 mm", "150 mm"]
rpy = ["0 deg", "0 deg", "30 deg"]
[[cell.plane]]
name = "wall"
point = [-3.0, 0.0, 0.0]
normal = [1.0, 0.0, 0.0]
[[cell.mesh]]
name = "table"
file = "table.stl"
position = [3.0, 0.0, 0.0]
scale = 0.001
"""
_UNCERTAINTY = """
[uncertainty]
stiffness = [0.2, 0.2, 0.2, 0.3, 0.3, 0.3]
damping = 0.5
payload = 0.1
servo_bandwidth = "15 Hz"
servo_feed_forward = 0.9
servo_delay = "2 ms"
draws = 50
seed = 2
"""
_LEFT_OPEN = """
[left_open]
cutoff = "12 Hz"
predict = ["20 Hz", "25 Hz"]
torque = [0.4, 0.2]
link_position = [2e-05, 2e-05]
[left_open.suspects]
backlash = 0.02
stribeck = 0.01
"""
_HYPERCUBE = """schema = 1
kind = "sweep"
base = "small.toml"
starts = 1
[latin_hypercube]
count = 3
seed = 4
[latin_hypercube."motion.duration"]
lower = "1 s"
upper = "2 s"
[lists]
"method.intervals" = [6, 8]
"""
_TRIANGLE = """solid table
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 500 0 0
vertex 0 500 0
endloop
endfacet
facet normal 0 0 1
outer loop
vertex 500 0 0
vertex 500 500 0
vertex 0 500 0
endloop
endfacet
endsolid table
"""


def surroundings(place: Path) -> Iterator[Subject]:
    """Beside what `documents` and `sets` have laid out below `place`."""
    from stiffopt.discovery.extended.model import load_extended
    from stiffopt.problem.files import load_problem
    from stiffopt.recording.recording_set import load_recordings
    from stiffopt.sweep.cases import load_sweep

    shared, toml = place / "problems", mutators.spoiled_toml
    out = ("--out", "out", "--quiet")
    (shared / "table.stl").write_text(_TRIANGLE)
    for kind, base, more in (
        ("cell", "small.toml", _CELL),
        ("uncertainty", "ur10_shaped_deviation.toml", _UNCERTAINTY),
    ):
        (shared / f"{kind}.toml").write_text((shared / base).read_text() + more)
        command = ("solve", f"{kind}.toml", *out)
        yield Subject(kind, shared, f"{kind}.toml", toml, load_problem, command, whole=False)
    (shared / "hypercube.toml").write_text(_HYPERCUBE)
    command = ("sweep", "hypercube.toml", *out, "--workers", "1")
    yield Subject("hypercube", shared, "hypercube.toml", toml, load_sweep, command, whole=False)
    (shared / "left_open.toml").write_text((shared / "extended.toml").read_text() + _LEFT_OPEN)
    quick = ("--no-report", "--no-experiment")
    command = ("diagnose", "set", *out, *quick, "--model", "left_open.toml")
    yield Subject("left open", shared, "left_open.toml", toml, load_extended, command, whole=False)
    currents = place / "currents"
    shutil.copytree(RECORDED, currents)
    text = (currents / "recordings.toml").read_text()
    scaled = 'torque_side = "motor"\n\n[signals.scale]\ntorque = ["A", "A"]\n'
    (currents / "recordings.toml").write_text(text.replace('torque_side = "motor"\n', scaled))
    yield Subject("currents", currents, "recordings.toml", toml, load_recordings, CHECK)
