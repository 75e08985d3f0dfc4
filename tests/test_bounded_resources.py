"""Files that ask for time, memory or a crash: one reading guard for each kind refuses them."""

import json
import os
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from small_arms import ROOT

from benchmarks.reliability.mutants import alone
from stiffopt.discovery import diagnose
from stiffopt.discovery.comparison.evidence import _FactoredSums
from stiffopt.errors import InputError, InputFileError, RobotError, UnitError
from stiffopt.files import MAX_STRING_LENGTH, atomic_write, load_json, load_toml, read_table
from stiffopt.folders import check_result
from stiffopt.recording.clock import read_clock
from stiffopt.recording.readers.read import read_columns, read_tables
from stiffopt.recording.readers.text_table import MAX_LINE
from stiffopt.recording.signals import Signals
from stiffopt.result.store import MAX_SAMPLES, export_times
from stiffopt.robot.link_shapes import convex_hull, load_mesh_file
from stiffopt.robot.urdf import MAX_MOVING_JOINTS, load_urdf
from stiffopt.robot.xml_files import MAX_DEPTH, MAX_ELEMENTS, parse_xml
from stiffopt.starter.writing import toml_string
from stiffopt.units import joint_to_si, to_si

TABLE = Signals(time="t", position=("q",), velocity=None, link_position=None, torque=("tau",))
READERS = {
    "toml": load_toml,
    "json": load_json,
    "urdf": load_urdf,
    "csv": lambda path: read_columns(path, TABLE),
    "parquet": lambda path: read_columns(path, TABLE),
    "txt": read_tables,
    "table": lambda path: read_table(path, ["t"]),
    "stl": lambda path: load_mesh_file(path, np.ones(3)),
}


@pytest.mark.parametrize("ending", READERS)
def test_a_pipe_is_refused_by_every_reader(ending, tmp_path):
    path = tmp_path / f"a.{ending}"
    os.mkfifo(path)
    verdict, what = alone(lambda: READERS[ending](path), tmp_path, processor=5)
    assert verdict == "told", what
    with pytest.raises(InputFileError, match="is a device or a pipe"):
        READERS[ending](path)


def test_a_pipe_in_a_folder_of_results_is_refused(tmp_path):
    entry = {"by": "solve", "sha256": "0" * 64}
    (tmp_path / "manifest.json").write_text(json.dumps({"files": {"result.json": entry}}))
    os.mkfifo(tmp_path / "result.json")
    with pytest.raises(InputFileError, match="pipe or device"):
        check_result(tmp_path, "result.json")


def processor_time(work):
    began = time.process_time()
    with pytest.raises(InputError):
        work()
    return time.process_time() - began


@pytest.mark.parametrize(
    "word", ["a = 1" + "0" * 300_000, "a" * 300_000, "a = 'b'\nc = " + "x-" * 9]
)
def test_time_of_a_toml_file_grows_with_its_length(word, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(word)
    assert processor_time(lambda: load_toml(path)) < 1.0


def test_texts_of_a_toml_file_have_a_length(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(f'a = ["{"x" * (MAX_STRING_LENGTH + 1)}"]')
    with pytest.raises(InputFileError, match=r"a\[1\]: this text has more than 10000 characters"):
        load_toml(path)


@pytest.mark.parametrize("text", ["1" + " " * 100_000 + "x", "1" * 100_000 + "\nm", "1 m\n" * 9999])
def test_long_quantities_are_refused_at_once(text):
    assert processor_time(lambda: to_si(text, "length")) < 0.2
    with pytest.raises(UnitError, match="expected length"):
        to_si(text, "length")


@pytest.mark.parametrize("text", ["\ufeffa = 1\n", "a = 1\r\nb = 2\r\n"])
def test_byte_order_marks_and_line_ends_of_other_systems_are_read(text, tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(text.encode())
    assert load_toml(path)["a"] == 1


def stamps(jump):
    """400 samples at 200 Hz, a jump after the first half [s]."""
    return np.arange(400) * 0.005 + np.where(np.arange(400) < 200, 0.0, jump)


@pytest.mark.parametrize("jump", [86400.0, 3e7, 1e18])
def test_a_clock_that_jumps_by_days_is_named_with_its_row(jump, tmp_path):
    with pytest.raises(InputFileError, match=r"t, row 201: time goes on by .* Cut the file"):
        read_clock(stamps(jump), tmp_path / "run.csv", "t")


def test_a_pause_of_an_hour_is_a_gap(tmp_path):
    clock = read_clock(stamps(3600.0), tmp_path / "run.csv", "t")
    assert [fault.kind for fault in clock.faults] == ["gap"]


@pytest.mark.parametrize("step", [5e-324, 1e-300])
def test_a_clock_of_denormal_steps_is_no_overflow(step, tmp_path):
    time = np.concatenate([np.arange(30) * step, [1.0]])
    with pytest.raises(InputFileError, match=r"row 31|different times|no motion"):
        read_clock(time, tmp_path / "run.csv", "t")


def test_numbers_whose_squares_underflow_are_none_of_a_sensor(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,q,tau\n" + "".join(f"{k},1e-9,{k}e-300\n" for k in range(30)))
    columns = read_columns(path, TABLE)
    assert not columns["tau"].any()
    assert set(columns["q"]) == {1e-9}


def test_a_table_without_rows_is_said_and_no_warning(tmp_path, recwarn):
    path = tmp_path / "run.csv"
    path.write_text("t,q,tau\n")
    with pytest.raises(InputFileError, match="holds no rows below its header"):
        read_columns(path, TABLE)
    assert not recwarn.list


def test_a_table_of_one_long_line_is_refused(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text("1.0 " * (MAX_LINE // 4 + 1))
    with pytest.raises(InputFileError, match="is no table: a line has"):
        read_tables(path)[""]


@pytest.mark.parametrize("dimension", ["time", "torque"])
def test_a_unit_that_is_none_is_told_of_any_quantity(dimension):
    with pytest.raises(UnitError, match="the unit 'x' is not known"):
        joint_to_si("1 x", dimension)


def test_more_samples_than_any_table_are_refused():
    assert len(export_times(2.0, 500.0)) == 1001
    # What a long solve has found is kept, at a lower rate.
    assert MAX_SAMPLES <= len(export_times(1e4)) <= MAX_SAMPLES + 2
    for duration, rate in ((1e9, 500.0), (1.0, 1e15), (np.inf, 1.0), (np.nan, 1.0)):
        with pytest.raises(InputError, match=r"more than 1e\+06 samples"):
            export_times(duration, rate)


DEEP = "<a>" * 100_000 + "</a>" * 100_000
XML = {
    "deep": (f'<robot name="r">{DEEP}</robot>', f"deeper than {MAX_DEPTH}"),
    "wide": (f'<robot name="r">{"<a/>" * MAX_ELEMENTS}</robot>', "more than 100000 elements"),
    "entity": ('<!DOCTYPE r [<!ENTITY a "b">]><robot name="r">&a;</robot>', "declares the entity"),
    "encoding": ('<?xml version="1.0" encoding="utf-99"?><robot/>', "is not a URDF"),
}


@pytest.mark.parametrize("case", XML)
def test_xml_is_bounded_before_a_tree_is_built(case, tmp_path):
    text, what = XML[case]
    (tmp_path / "r.urdf").write_text(text)
    with pytest.raises(InputFileError, match=what):
        parse_xml(tmp_path / "r.urdf")


def chain(count):
    """URDF of a chain of revolute joints."""
    parts = ['<robot name="r"><link name="l0"/>']
    for k in range(1, count + 1):
        parts.append(
            f'<link name="l{k}"><inertial><mass value="1"/>'
            '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
            f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
            '<axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="5" effort="40"/></joint>'
        )
    return "".join(parts) + "</robot>"


def test_an_arm_has_no_more_joints_than_its_dynamics_can_hold(tmp_path):
    path = tmp_path / "r.urdf"
    path.write_text(chain(MAX_MOVING_JOINTS))
    assert len(load_urdf(path).joints) == MAX_MOVING_JOINTS
    path.write_text(chain(900))
    with pytest.raises(RobotError, match="900 joints move, at most 50 are read"):
        load_urdf(path)


def write_triangles(path, triangles):
    """A binary STL of triangles (T, 3, 3)."""
    facets = [struct.pack("<12fH", 0, 0, 1, *each.ravel(), 0) for each in triangles]
    path.write_bytes(bytes(80) + struct.pack("<I", len(facets)) + b"".join(facets))


def corners(*, thickness=1.0):
    """Triangles (12, 3, 3) of a tetrahedron, thrice."""
    tips = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, thickness]], dtype=float)
    faces = tips[[[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]]
    return np.concatenate([faces, faces, faces])


def spoiled(value):
    wrong = corners()
    wrong[2, 1, 0] = value
    return wrong


MESHES = {
    "nan": (spoiled(np.nan), 1.0, "cannot be used as a mesh"),
    "infinite": (spoiled(np.inf), 1.0, "cannot be used as a mesh"),
    "scale zero": (corners(), 0.0, "has the scale"),
    "scale nan": (corners(), np.nan, "has the scale"),
    "scale of atoms": (corners(), 1e-12, "cannot be used as a mesh"),
    "scale of planets": (corners(), 1e9, "cannot be used as a mesh"),
    "flat": (corners(thickness=0.0), 1.0, "is flat"),
    "thin as rounding": (corners(thickness=1e-9), 1.0, "is flat"),
}


@pytest.mark.parametrize("case", MESHES)
def test_a_mesh_is_checked_before_it_can_crash(case, tmp_path):
    triangles, scale, what = MESHES[case]
    path = tmp_path / "m.stl"
    write_triangles(path, triangles)

    def hull():
        with pytest.raises(InputFileError, match=what):
            convex_hull(load_mesh_file(path, np.full(3, scale)), path)

    assert alone(hull, tmp_path) == ("accepted", "")


def test_a_sound_mesh_has_its_hull(tmp_path):
    write_triangles(tmp_path / "m.stl", corners(thickness=1e-3))
    mesh = load_mesh_file(tmp_path / "m.stl", np.array([1.0, -2.0, 1.0]), boxes=True)
    assert np.ptp(np.array(mesh.vertices()), axis=0) == pytest.approx([1.0, 2.0, 1e-3])
    assert convex_hull(mesh, None).num_points == 4


def test_a_toml_file_names_no_file_that_it_cannot():
    assert toml_string("é") == '"é"'
    with pytest.raises(InputError, match="is not UTF-8, which a TOML file cannot hold"):
        toml_string(os.fsdecode(b"bras_\xff.urdf"))


def test_names_that_are_not_utf8_are_kept_in_json(tmp_path):
    name = os.fsdecode(b"bras_\xff")
    atomic_write(tmp_path / "a.json", json.dumps({"file": name}, ensure_ascii=False))
    assert load_json(tmp_path / "a.json") == {"file": name}


SAID = "from stiffopt.streams import open_streams, output_failure; open_streams(); "


def said(code, stdout=subprocess.PIPE, **environment):
    return subprocess.run(
        [sys.executable, "-c", SAID + code],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        stdout=stdout,
        stderr=subprocess.PIPE,
        check=False,
    )


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_no_character_loses_an_answer(encoding):
    done = said(r"print('5 \u00b1 1 \u03bcm \udcff')", PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(b"5 ")
    assert done.stdout.endswith(b"\\udcff\n")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no /dev/full")
def test_a_full_disk_is_told_and_ends_nothing():
    with open("/dev/full", "w") as full:
        done = said("print('x' * 10**6); raise SystemExit(output_failure().errno)", stdout=full)
    assert (done.returncode, done.stderr) == (28, b"")


def test_a_reader_that_has_read_enough_is_no_fault():
    inward, outward = os.pipe()
    os.close(inward)
    with os.fdopen(outward, "w") as closed:
        done = said("print('x' * 10**6); assert output_failure() is None", stdout=closed)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no /dev/full")
def test_an_answer_is_kept_where_its_words_cannot_be_written(tmp_path):
    problem = (ROOT / "problems/two_link.toml").read_text()
    folder = tmp_path / os.fsdecode(b"bras_\xff")
    folder.mkdir()
    (folder / "p.toml").write_text(problem.replace("intervals = 20\n", "intervals = 8\n"))
    for name in ("two_link_robot.toml", "two_link.urdf"):
        (folder / name).write_bytes((ROOT / "problems" / name).read_bytes())
    command = [sys.executable, "-m", "stiffopt", "solve", folder / "p.toml", "--out", folder / "o"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii"}
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*command, "--quiet"], stdout=full, stderr=subprocess.PIPE, env=environment, check=False
        )
    assert done.returncode == 0
    assert b"stdout: No space left on device" in done.stderr
    assert b"was written nevertheless" in done.stderr
    assert (folder / "o" / "result.json").is_file()


@pytest.mark.parametrize("size", [1e3, 1e17, 3.3e19, 7.7e22, 1e28])
def test_evidence_of_a_column_that_another_holds_is_finite(size):
    sums = np.array([[[size]]]), np.array([[size]]), np.array([size])
    known = _FactoredSums(*sums, np.ones(1))
    for share in np.linspace(0.999, 1.001, 21):
        column = np.array([[share * size]])
        added = known.with_few(column, share * column, column[0])
        assert np.isfinite(added.log_evidence)


def test_a_fit_beyond_double_precision_is_told(monkeypatch):
    def fails(*_, **__):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(diagnose, "_run_diagnosis", fails)
    with pytest.raises(InputFileError, match="differ by more than a fit can hold"):
        diagnose.diagnose(ROOT / "problems/recordings/two_link_friction")
