"""Files that ask for too much, lead in circles or are none: one sentence, in no time."""

import io
import json
import os
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reliability.commands import BYTES
from benchmarks.reliability.mutants import alone
from benchmarks.reliability.mutators import json_messages, mcap_of_json
from stiffopt.cli import run
from stiffopt.errors import InputError, InputFileError, RobotError, shortened
from stiffopt.files import load_toml
from stiffopt.recording.readers import checks
from stiffopt.recording.readers.read import read_columns
from stiffopt.recording.signals import Signals
from stiffopt.robot.urdf import load_urdf
from stiffopt.units import convert, to_si

TABLE = Signals(
    time="t", position=("q",), velocity=None, link_position=None, torque=("tau",)
)  # fmt: skip
SPOKEN = Signals(
    time="",
    position=("/joint_states.position[joint1]",),
    velocity=None,
    link_position=None,
    torque=("/joint_states.effort[0]",),
)

DEEP = {
    "lists": "a = " + "[" * 60 + "]" * 60,
    "lists beyond Python's stack": "a = " + "[" * 9000 + "]" * 9000,
    "tables": "a = " + "{b = " * 60 + "1" + "}" * 60,
    "a key of many parts": ".".join("a" * 60) + " = 1",
    "a key that would take hours": ".".join(["a"] * 40_000) + " = 1",
    "a header of many parts": "[" + ".".join(["a"] * 2000) + "]",
}


@pytest.mark.parametrize("case", DEEP)
def test_nothing_is_that_deep(case, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(DEEP[case])
    with pytest.raises(InputFileError, match=r"nested deeper than 40|more than 40 parts"):
        load_toml(path)


@pytest.mark.parametrize("value", ["9" * 30, "-" + "9" * 400, "9" * 9000, "0x" + "f" * 9000])
def test_integers_have_64_bits(value, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(f"a = [0, {{b = {value}}}]")
    with pytest.raises(InputFileError, match="more than 64 bits"):
        load_toml(path)


@pytest.mark.parametrize(
    "unit", ["9**9**9**9 m", "m**99", "m^1e9", "(" * 500 + "m", "m" * 5000, "5 m/", "m..", "\x00"]
)
def test_units_are_not_worked_out(unit):
    with pytest.raises(InputError, match=r"cannot be read|not known|expected length"):
        to_si(f"1 {unit}", "length")
    with pytest.raises(InputError):
        convert(1.0, "m", unit)


def test_units_as_people_write_them():
    for text, dimension, value in (
        ("2 N*m/arcmin", "stiffness", 2.0 * 10800 / np.pi),
        ("1 kg * m^2", "inertia", 1.0),
        ("3 m/s**2", "acceleration", 3.0),
        ("1 N/(mm*um)", "stiffness per width", 1e9),
        ("1 µm", "length", 1e-6),
    ):
        assert to_si(text, dimension) == pytest.approx(value, rel=1e-12)


def test_what_is_long_is_shortened():
    assert len(shortened("x" * 10**6)) <= 100
    assert "too long" in shortened(10**5000)


LINK = '<link name="{}"/>'
JOINT = (
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/>'
    '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
)
TREES = {
    "its own parent": (LINK.format("a"), JOINT.format("j", "a", "a"), "form a loop"),
    "a loop": (
        "".join(map(LINK.format, "abc")),
        JOINT.format("j", "b", "c") + JOINT.format("k", "c", "b"),
        "form a loop",
    ),
    "two parents": (
        "".join(map(LINK.format, "abc")),
        JOINT.format("j", "a", "c") + JOINT.format("k", "b", "c"),
        "child of two joints",
    ),
    "two roots": ("".join(map(LINK.format, "abc")), JOINT.format("j", "a", "b"), "no joint to a"),
    "a link twice": (LINK.format("a") * 2, "", "2 links are named 'a'"),
    "a joint twice": (
        "".join(map(LINK.format, "abc")),
        JOINT.format("j", "a", "b") + JOINT.format("j", "b", "c"),
        "2 joints are named 'j'",
    ),
    "no name": ("<link/>", "", "has no name"),
    "no such link": (LINK.format("a"), JOINT.format("j", "a", "b"), "which is no link"),
    "too many": ("".join(map(LINK.format, range(1001))), "", "at most 1000"),
    "no number": (
        "".join(map(LINK.format, "ab")),
        JOINT.format("j", "a", "b").replace('"1"', '"nan"'),
        "finite number",
    ),
}


@pytest.mark.parametrize("case", TREES)
def test_a_urdf_is_checked_before_its_library_sees_it(case, tmp_path):
    links, joints, what = TREES[case]
    path = tmp_path / "r.urdf"
    path.write_text(f'<robot name="r">{links}{joints}</robot>')
    with pytest.raises((RobotError, InputFileError), match=what):
        load_urdf(path)


def test_prefixes_of_a_urdf_need_no_declaration(tmp_path):
    """Files with extensions of simulators often lack it, and other readers take them."""
    path = tmp_path / "r.urdf"
    joint = JOINT.format("j", "a", "b").replace("<limit", '<limit drake:acceleration="2.5"')
    assert "drake:" in joint
    links = "".join(map(LINK.format, "ab"))
    path.write_text(f'<robot name="r">{links}{joint}<drake:joint/></robot>')
    assert list(load_urdf(path).joints) == ["j"]


def test_entities_of_a_urdf_do_not_multiply(tmp_path):
    path = tmp_path / "r.urdf"
    rows = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
    path.write_text(f'<!DOCTYPE r [<!ENTITY e0 "ha">{rows}]><robot name="r">&e11;</robot>')
    with pytest.raises(InputFileError, match="declares the entity 'e0'"):
        load_urdf(path)


def npz_of_zeros(path, shape):
    """An archive that declares arrays of a shape, zeros that pack to almost nothing."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("t", "q", "tau"):
            with archive.open(f"{name}.npy", "w") as stream:
                stream.write(header.getvalue())
                stream.write(bytes(10**6))


@pytest.mark.parametrize("shape", [(10**9,), (10**5, 10**5), (10**30,)])
def test_zip_bombs_are_not_unpacked(shape, tmp_path):
    npz_of_zeros(tmp_path / "a.npz", shape)
    with pytest.raises(InputFileError, match=r"a\.npz: declares 10+ samples"):
        read_columns(tmp_path / "a.npz", TABLE)


def test_archives_of_other_things(tmp_path):
    path = tmp_path / "a.npz"
    np.save(tmp_path / "a.npy", np.zeros(3))
    (tmp_path / "a.npy").rename(path)
    with pytest.raises(InputFileError, match="cannot be read as an NPZ file of numbers"):
        read_columns(path, TABLE)
    np.savez(path, t=np.zeros(3), q=np.array([{}, 1, 2]), tau=np.zeros(3))
    with pytest.raises(InputFileError, match="a list of numbers, got object"):
        read_columns(path, TABLE)


def test_chunks_that_unpack_to_too_much(tmp_path, monkeypatch):
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap_of_json(json_messages()))
    assert len(read_columns(path, SPOKEN)[""]) == 60
    monkeypatch.setattr(checks, "MAX_BYTES", 1000)
    with pytest.raises(InputFileError, match="GiB, unpacked"):
        read_columns(path, SPOKEN)
    monkeypatch.undo()
    monkeypatch.setattr(checks, "MAX_MESSAGES", 50)
    with pytest.raises(InputFileError, match="has more than 50 messages"):
        read_columns(path, SPOKEN)
    monkeypatch.undo()
    monkeypatch.setattr(checks, "MAX_NUMBERS", 50)
    with pytest.raises(InputFileError, match="samples of 2 columns"):
        read_columns(path, SPOKEN)


def test_messages_of_other_things(tmp_path):
    path = tmp_path / "a.mcap"
    messages = json_messages()
    stamp = {"stamp": {"sec": [1]}}
    for place, value in (("effort", 3), ("effort", [[1]]), ("name", 5), ("header", stamp)):
        for message in messages[:30]:
            message[place] = value
        path.write_bytes(mcap_of_json(messages))
        read_columns(path, SPOKEN)  # the others are read, on one clock
    messages[0] = json.dumps(messages[1]).encode()[:-5]
    path.write_bytes(mcap_of_json(messages))
    with pytest.raises(InputFileError, match="cannot be read as MCAP: "):
        read_columns(path, SPOKEN)


def test_a_reader_that_wants_all_memory_is_stopped(tmp_path):
    from stiffopt.recording.readers import npz

    def greedy(*_):
        # More than the tens of megabytes that malloc may keep free of what the process holds, and
        # less than the child's own limit.
        return {"t": np.zeros((checks.MAX_MEMORY + 2**28) // 8)}

    assert checks.MAX_MEMORY + 2**28 < BYTES
    kept = np.ones(30 * 2**17)
    del kept  # malloc keeps blocks of that size on its heap from now on
    kept = np.ones(25 * 2**17)
    del kept
    (tmp_path / "a.npz").write_bytes(b"")
    npz.read = greedy  # in the child alone
    try:
        verdict = alone(lambda: read_columns(tmp_path / "a.npz", TABLE), tmp_path)
    finally:
        from importlib import reload

        reload(npz)
    assert verdict == ("told", "")
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with checks.bounded_memory():
        assert resource.getrlimit(resource.RLIMIT_DATA) != before
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_a_deep_stack_is_no_room_for_data():
    def under(calls):
        # Sorting calls back from C: every level takes some kilobytes of the stack.
        return sorted([calls], key=lambda k: under(k - 1) if k else [])

    def stack():
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(1024 * int(each.split()[1]) for each in lines if each.startswith("VmStk:"))

    before = checks.data_segment_size()
    under(250)
    assert stack() > 2**20
    with checks.bounded_memory():
        most, _ = resource.getrlimit(resource.RLIMIT_DATA)
    assert most - checks.MAX_MEMORY - before < 2**19


def test_no_file_runs_code(tmp_path):
    """Only `--effects` takes Python: neither a pickle in an archive nor a file elsewhere runs."""

    class Harm:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "harmed"),)

    np.savez(tmp_path / "a.npz", t=np.array([Harm()]), q=np.zeros(1), tau=np.zeros(1))
    with pytest.raises(InputFileError):
        read_columns(tmp_path / "a.npz", TABLE)
    (tmp_path / "a.toml").write_text(f"import os\nos.mkdir({str(tmp_path / 'harmed')!r})\n")
    for command in ("solve", "preload", "diagnose", "stiffness", "verify"):
        assert run([command, str(tmp_path / "a.toml")]) == 2
    assert not (tmp_path / "harmed").exists()
