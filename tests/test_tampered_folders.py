"""Folders that somebody else made: refused with a sentence, and nothing outside them is touched."""

import json
import os
import socket
from pathlib import Path

import pytest

from stiffopt.cli import run
from stiffopt.folders import MANIFEST, check_result, output_folder

RESULT = {"inputs_hash": "0", "certificate": None, "problem": "p.toml"}
DIGEST = "0" * 64


def listing(**files):
    """Text of a manifest with entries by name."""
    return json.dumps({"schema": 1, "files": files})


def entry(**changed):
    return {"by": "solve", "sha256": DIGEST} | changed


def names(*listed):
    return lambda d, _: (d / MANIFEST).write_text(
        json.dumps({"files": {n: entry() for n in listed}})
    )


def manifest(text):
    return lambda d, _: (d / MANIFEST).write_text(text)


def linked(name, to=""):
    def make(d, outside):
        (d / name).unlink(missing_ok=True)
        (d / name).symlink_to(outside / to)

    return make


def made(name, kind):
    def make(d, _):
        (d / name).unlink(missing_ok=True)
        if kind == "socket":
            here = os.getcwd()
            os.chdir(d)  # names of sockets are short
            with socket.socket(socket.AF_UNIX) as bound:
                bound.bind(name)
            os.chdir(here)
        else:
            {"fifo": os.mkfifo, "folder": os.mkdir}[kind](d / name)

    return make


def sparse(d, _):
    with (d / "trajectory.csv").open("wb") as stream:
        stream.truncate(2**40)
    (d / MANIFEST).write_text(listing(**{"trajectory.csv": entry()}))


def plan(text):
    """The working folder of an earlier version, with moves out of the folder."""

    def make(d, outside):
        (d / ".stiffopt" / "new").mkdir(parents=True)
        (d / ".stiffopt" / "new" / "x").write_text("planted")
        moves = text.replace("OUT", str(outside / "precious"))
        (d / ".stiffopt" / "plan").write_text(moves)

    return make


def half(d, _):
    (d / ".stiffopt").mkdir()
    (d / ".stiffopt" / "half").write_text("{")


def stage(place, *, replaces="", link_to=""):
    """A complete stage of somebody else, whose manifest lists a file that it has not."""

    def make(d, outside):
        folder = d / ".stiffopt.new" if place == "inside" else d.parent / f".{d.name}.stiffopt"
        folder.mkdir()
        (folder / MANIFEST).write_text(listing(**{"result.json": entry()}))
        (folder / ".replaces").write_text(replaces)
        if link_to:
            (folder / "result.json").symlink_to(outside / link_to)

    return make


def escaping_stage(name):
    def make(d, _):
        (d / ".stiffopt.new").mkdir()
        (d / ".stiffopt.new" / ".replaces").write_text("")
        (d / ".stiffopt.new" / MANIFEST).write_text(listing(**{name: entry()}))

    return make


def linked_stage(d, outside):
    (d.parent / f".{d.name}.stiffopt").symlink_to(outside)


def listed_below_link(d, outside):
    (d / "figures").symlink_to(outside)
    (d / MANIFEST).write_text(listing(**{"figures/precious": entry()}))


def listed_link(name):
    def make(d, outside):
        linked(name, "precious")(d, outside)
        (d / MANIFEST).write_text(listing(**{name: entry()}))

    return make


# What is wrong with a folder of a solve that both a reader and a writer must refuse.
FOR_BOTH = {
    "plan that moves a file in": plan('{"kept": {".stiffopt/new/x": "OUT"}, "out": [], "in": []}'),
    "plan that moves a file out": plan('{"kept": {"OUT": "y"}, "out": [], "in": []}'),
    "plan that removes": plan('{"kept": {}, "out": ["OUT"], "in": []}'),
    "plan that is a list": plan("[]"),
    "plan that is no text": plan("\udcff".encode("utf-8", "surrogateescape").decode("latin-1")),
    "half of a plan": half,
    "hidden folder as a link": linked(".stiffopt"),
    "hidden folder as a file": lambda d, _: (d / ".stiffopt").write_text(""),
    "name that is absolute": names("/etc/passwd"),
    "name above": names("../outside/precious"),
    "name above from below": names("figures/../../outside/precious"),
    "name of this folder": names("./result.json"),
    "name that is empty": names(""),
    "name with an empty part": names("figures//one.svg"),
    "name that ends as a folder": names("figures/"),
    "name with NUL": names("a\0b"),
    "name with a backslash": names("..\\precious"),
    "name with an escape": names("a\x1b[2Jb"),
    "name of a control file": names(".stiffopt.lock"),
    "name of the manifest": names(MANIFEST),
    "name that is hidden below": names("figures/.ssh"),
    "command with an escape": manifest(listing(x=entry(by="\x1b]0;x\x07"))),
    "command that is a list": manifest(listing(x=entry(by=[]))),
    "of that is a number": manifest(listing(x=entry(of=3))),
    "hash that is short": manifest(listing(x=entry(sha256="00"))),
    "entry that is a list": manifest(listing(x=[])),
    "files that are a list": manifest('{"files": []}'),
    "manifest that is a list": manifest("[]"),
    "manifest that is cut off": manifest('{"files": {'),
    "manifest nested deep": manifest("[" * 100_000),
    "manifest as a link": linked(MANIFEST, "precious"),
    "manifest as a pipe": made(MANIFEST, "fifo"),
    "manifest as a folder": made(MANIFEST, "folder"),
    "manifest as a socket": made(MANIFEST, "socket"),
    "lock as a link": linked(".stiffopt.lock", "precious"),
    "lock as a link to nowhere": linked(".stiffopt.lock", "new"),
    "lock as a pipe": made(".stiffopt.lock", "fifo"),
    "lock as a folder": made(".stiffopt.lock", "folder"),
    "stage beside as a link": linked_stage,
    "stage inside as a link": linked(".stiffopt.new"),
    "stage inside as a file": lambda d, _: (d / ".stiffopt.new").write_text(""),
    "stage beside without its files": stage("beside"),
    "stage inside without its files": stage("inside"),
    "stage with a link for a file": stage("inside", link_to="precious"),
    "stage with a name above": escaping_stage("../outside/precious"),
    "stage with an absolute name": escaping_stage("/etc/x"),
    "listed file as a link": listed_link("result.json"),
    "listed file below a link": listed_below_link,
    "listed file as large as a disk": sparse,
}
# What only a reader must refuse; a writer puts it aside.
FOR_READERS = {
    "result as a link": linked("result.json", "result.json"),
    "trajectory as a link": linked("trajectory.csv", "precious"),
    "result as a pipe": made("result.json", "fifo"),
    "trajectory as a pipe": made("trajectory.csv", "fifo"),
    "result as a folder": made("result.json", "folder"),
}


@pytest.fixture
def outside(tmp_path):
    """A folder of the user's, which no command may change."""
    folder = tmp_path / "outside"
    (folder / "warm").mkdir(parents=True)
    (folder / "precious").write_text("precious")
    (folder / "warm" / "state").write_text("precious")
    (folder / "result.json").write_text(json.dumps(RESULT))
    before = state(folder)
    yield folder
    assert state(folder) == before


def state(folder):
    return {p: (p.lstat().st_mtime_ns, p.is_dir() or p.read_text()) for p in folder.rglob("*")}


def foreign(tmp_path, outside, tamper):
    """A folder of a solve without manifest, with something wrong."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps(RESULT))
    (folder / "trajectory.csv").write_text("t,q1\n0,0\n1,1\n")
    tamper(folder, outside)
    return folder


def said(capsys, *command):
    """Error of a command that must end with 2 and one sentence."""
    assert run([str(part) for part in command]) == 2
    error = capsys.readouterr().err
    assert "Traceback" not in error
    assert error.count("\n") == 1, error
    assert "\x1b" not in error
    return error


@pytest.mark.parametrize("fault", [*FOR_BOTH, *FOR_READERS])
def test_readers_refuse(tmp_path, outside, capsys, fault):
    folder = foreign(tmp_path, outside, (FOR_BOTH | FOR_READERS)[fault])
    for command in (("simulate", folder), ("export", folder, "--to", "csv")):
        error = said(capsys, *command)
        assert str(tmp_path) in error
        assert "certificate" not in error, error  # what reading went on to


@pytest.mark.parametrize("fault", FOR_BOTH)
def test_writers_refuse(tmp_path, outside, fault):
    folder = foreign(tmp_path, outside, FOR_BOTH[fault])
    from stiffopt.errors import InputFileError

    with pytest.raises(InputFileError), output_folder(folder, "solve"):
        pytest.fail("begun")


@pytest.mark.parametrize("fault", FOR_READERS)
def test_writers_set_aside_what_stands_in_the_way(tmp_path, outside, fault):
    folder = foreign(tmp_path, outside, FOR_READERS[fault])
    with output_folder(folder, "solve") as stage:
        for name in ("result.json", "trajectory.csv", "figures/one.svg"):
            (stage / name).parent.mkdir(exist_ok=True)
            (stage / name).write_text("new")
    for name in ("result.json", "trajectory.csv"):
        assert (folder / name).read_text() == "new"
        assert os.path.lexists(folder / f"{name}.kept")
    check_result(folder, "result.json", "trajectory.csv")


def test_a_folder_as_a_link_below_the_target_is_set_aside(tmp_path, outside):
    folder = foreign(tmp_path, outside, linked("figures"))
    with output_folder(folder, "solve") as stage:
        (stage / "figures").mkdir()
        (stage / "figures" / "precious").write_text("new")
    assert (folder / "figures.kept").is_symlink()
    assert (folder / "figures" / "precious").read_text() == "new"


@pytest.mark.parametrize("name", ["result.json", "diagnosis.json"])
def test_compare_refuses_links(tmp_path, outside, capsys, name):
    folder = foreign(tmp_path, outside, linked("result.json", "result.json"))
    (folder / "result.json").rename(folder / name)
    assert "link" in said(capsys, "compare", folder, folder)


@pytest.mark.parametrize("make", [listed_link("extended.toml"), made("extended.toml", "fifo")])
def test_a_model_is_no_link_out_of_its_folder(tmp_path, outside, make):
    from stiffopt.discovery.extended.model import load_extended
    from stiffopt.errors import InputFileError

    folder = foreign(tmp_path, outside, make)
    with pytest.raises(InputFileError, match=r"link|pipe"):
        load_extended(folder / "extended.toml")


def test_a_model_that_was_edited_is_taken(tmp_path):
    folder = tmp_path / "diagnosis"
    with output_folder(folder, "diagnose") as stage:
        (stage / "extended.toml").write_text("one")
    (folder / "extended.toml").write_text("two")
    check_result(folder, "extended.toml", edited=True)


def test_where_the_parent_cannot_be_written(tmp_path):
    """Files are then staged inside; a folder that is its own file system looks the same."""
    from stiffopt import folders

    folder = tmp_path / "out"
    with output_folder(folder, "solve") as beside:
        pass
    assert beside.parent == Path(os.path.realpath(tmp_path))
    # Not for root, whom no permission stops: nothing can be renamed onto a folder that holds files.
    (tmp_path / ".out.stiffopt").mkdir()
    (tmp_path / ".out.stiffopt" / "x").write_text("")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(folders, "_complete_interrupted", lambda path: None)
        with output_folder(folder, "solve") as stage:
            (stage / "a").write_text("new")
            assert stage.parent == Path(os.path.realpath(folder))
    assert sorted(p.name for p in folder.iterdir()) == ["a", MANIFEST]


@pytest.mark.parametrize("place", ["cases", "cases/warm"])
def test_a_sweep_keeps_no_case_behind_a_link(tmp_path, outside, place):
    from stiffopt.errors import InputFileError
    from stiffopt.sweep.cases import Sweep
    from stiffopt.sweep.run import run_sweep

    link = tmp_path / "sweep" / place
    link.parent.mkdir(parents=True)
    link.symlink_to(outside)
    sweep = Sweep.__new__(Sweep)
    with pytest.raises(InputFileError, match="is a link"):
        run_sweep(sweep, tmp_path / "sweep", None)


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        "[]",
        '{"key": "k"}',
        '{"key": "k", "status": "optimal", "values": {"a": 3}}',
        "[" * 9999,
    ],
)
def test_a_case_file_of_something_else_is_made_anew(tmp_path, text):
    from stiffopt.sweep.run import _read_case

    (tmp_path / "cases").mkdir()
    (tmp_path / "cases" / "k.json").write_text(text)
    assert _read_case(tmp_path, "k") is None
    (tmp_path / "cases" / "k.json").unlink()
    os.mkfifo(tmp_path / "cases" / "k.json")
    assert _read_case(tmp_path, "k") is None
