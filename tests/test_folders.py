"""Folders for results: all files of a run or none, and nothing of anybody else's lost."""

import json
import os
import resource
import signal
import subprocess
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest

from stiffopt import folders
from stiffopt.errors import InputFileError
from stiffopt.folders import MANIFEST, check_result, output_folder
from stiffopt.interrupts import defer_while_writing


def tree(path):
    """Text by name of what a user sees; nothing hidden may stay."""
    files = {p.relative_to(path).as_posix(): p for p in path.rglob("*") if p.is_file()}
    assert not [name for name in files if name.startswith(".")], files
    return {name: p.read_text() for name, p in files.items() if name != MANIFEST}


def write(path, command="solve", of="", **files):
    """One run of a command: files by stem, all of them .txt."""
    with output_folder(path, command, of=of) as stage:
        for name, text in files.items():
            (stage / f"{name}.txt").write_text(text)


CHANGING = ("open", "replace", "rename", "unlink", "mkdir", "rmdir")


class Killed(BaseException):
    """Raised by every change of the file system from a moment on."""


def killed(step, work):
    """Return whether `work` came as far as the given change of the file system, and died there.

    Nothing changes any more once it is raised, as after a kill: what cleans up is stopped as well.
    """
    done = 0

    def dying(call):
        def counted(*arguments, **named):
            nonlocal done
            if done >= step:
                raise Killed
            done += 1
            return call(*arguments, **named)

        return counted

    with pytest.MonkeyPatch.context() as patch:
        for name in CHANGING:
            patch.setattr(os, name, dying(getattr(os, name)))
        try:
            work()
        except Killed:
            return True
    return False


def hidden(path):
    """Names of control files in a folder and beside it."""
    return [p.name for p in (*path.rglob(".*"), *path.parent.glob(f".{path.name}.*"))]


def test_a_folder_that_stays_empty_is_removed_with_those_above_it(tmp_path):
    with pytest.raises(KeyboardInterrupt), output_folder(tmp_path / "a" / "b", "solve"):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a", "a/b", "\0"])
def test_a_file_in_the_way(tmp_path, name):
    (tmp_path / "a").write_text("")
    with (
        pytest.raises(InputFileError, match=r"cannot be written|no name of a folder"),
        output_folder(tmp_path / name, "solve"),
    ):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_files_appear_together(tmp_path):
    with output_folder(tmp_path, "solve") as stage:
        (stage / "z.json").write_text("new")
        (stage / "figures").mkdir()
        (stage / "figures" / "one.svg").write_text("svg")
        assert [p.name for p in tmp_path.iterdir() if not p.name.startswith(".")] == []
    assert tree(tmp_path) == {"z.json": "new", "figures/one.svg": "svg"}
    assert set(json.loads((tmp_path / MANIFEST).read_text())["files"]) == set(tree(tmp_path))


def test_an_interruption_leaves_what_was_there(tmp_path):
    write(tmp_path, a="old")
    with suppress(KeyboardInterrupt), output_folder(tmp_path, "solve") as stage:
        (stage / "a.txt").write_text("new")
        raise KeyboardInterrupt
    assert tree(tmp_path) == {"a.txt": "old"}


def test_what_the_new_answer_has_not_goes_with_the_old(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    write(tmp_path, a="old", b="old")
    write(tmp_path, "simulate", of="solve", c="of the old")
    write(tmp_path, "preload", d="of another command")
    write(tmp_path, a="new")
    assert tree(tmp_path) == {
        "a.txt": "new", "d.txt": "of another command", "notes.txt": "mine"
    }  # fmt: skip


def test_a_users_own_files_are_kept(tmp_path, capsys):
    (tmp_path / "a.txt").write_text("mine")
    write(tmp_path, a="one", b="one")
    assert "a.txt.kept" in capsys.readouterr().err
    (tmp_path / "b.txt").write_text("edited")
    write(tmp_path, a="two")
    write(tmp_path, a="three")
    assert tree(tmp_path) == {"a.txt": "three", "a.txt.kept": "mine", "b.txt.kept": "edited"}


def test_nothing_of_an_earlier_version_stays_beside_a_new_answer(tmp_path):
    (tmp_path / "b.txt").write_text("of a version without manifest")
    with output_folder(tmp_path, "solve", maybe=("b.txt", "c.txt")) as stage:
        (stage / "a.txt").write_text("new")
    assert tree(tmp_path) == {"a.txt": "new", "b.txt.kept": "of a version without manifest"}


OLD, NEW = dict.fromkeys("abc", "old"), dict.fromkeys("abd", "new")


def by_file(answer):
    return {f"{name}.txt": text for name, text in answer.items()}


def laid_out(path, *, first):
    """A folder with a user's notes and an edited file; an old answer where it is not the first."""
    path.mkdir()
    (path / "notes.txt").write_text("mine")
    if not first:
        write(path, **OLD)
        write(path, "preload", e="of another command")
    (path / "d.txt").write_text("edited")


def own_files(path):
    """Files of the answer, after those of others have been looked at."""
    seen = {p.name: p.read_text() for p in path.iterdir() if ".txt" in p.name}
    assert seen.pop("notes.txt") == "mine"
    assert seen.pop("e.txt", "of another command") == "of another command"
    # The edited file stands where it stood, or under its other name.
    if seen.get("d.txt") == "edited":
        del seen["d.txt"]
    else:
        assert seen.pop("d.txt.kept") == "edited"
    return seen


@pytest.mark.parametrize(
    ("inside", "first", "reads"), [(False, False, False), (False, True, True), (True, False, True)]
)
def test_killed_before_each_change(tmp_path, monkeypatch, capsys, inside, first, reads):
    """Never old beside new; whoever comes next, killed itself or not, completes or clears it."""
    if inside:  # as where the folder's parent cannot be written
        monkeypatch.setattr(folders, "_stage_paths", lambda path: (Path("/proc/no"), path / ".s"))
    old, ends = {} if first else OLD, Counter()
    for step in range(200):
        path = tmp_path / str(step)
        laid_out(path, first=first)
        died = killed(step, lambda path=path: write(path, **NEW))
        killed(5 * step % 17, lambda path=path: write(path, "other"))
        seen = own_files(path)
        assert len(set(seen.values())) <= 1, (step, seen)
        if reads:
            check_result(path, "a.txt", "b.txt")
        else:
            with pytest.raises(KeyboardInterrupt), output_folder(path, "other"):
                raise KeyboardInterrupt
            assert hidden(path) == []
        seen = own_files(path)
        assert seen in (by_file(old), by_file(NEW)), step
        check_result(path, *seen)
        ends["new" if seen == by_file(NEW) else "old"] += 1
        if not died:
            break
    assert not died
    assert ends["old"] > 5, ends
    assert ends["new"] > 5, ends


def test_two_processes_never_mix(tmp_path):
    program = (
        "import sys; from pathlib import Path; from stiffopt.folders import output_folder\n"
        "with output_folder(Path(sys.argv[1]), 'solve'): print('in', flush=True); input()"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path / "out")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert other.stdout.readline() == "in\n"
    with pytest.raises(InputFileError, match="another stiffopt is writing"):
        write(tmp_path / "out", a="mine")
    other.communicate("\n")
    write(tmp_path / "out", a="mine")
    assert tree(tmp_path / "out") == {"a.txt": "mine"}


def test_a_tampered_or_mixed_folder_is_told(tmp_path):
    check_result(tmp_path, "a.txt")  # of an earlier version: without manifest
    write(tmp_path, a="one", b="one")
    check_result(tmp_path, "a.txt", "b.txt")
    (tmp_path / "c.txt").write_text("of another run")
    with pytest.raises(InputFileError, match=r"c\.txt: is of another run"):
        check_result(tmp_path, "a.txt", "c.txt")
    (tmp_path / "b.txt").write_text("two")
    with pytest.raises(InputFileError, match=r"b\.txt: was changed since `stiffopt solve`"):
        check_result(tmp_path, "a.txt", "b.txt")
    (tmp_path / MANIFEST).write_text('{"files": {"../x": {"by": "solve", "sha256": ""}}}')
    with pytest.raises(InputFileError, match="no manifest of stiffopt"):
        check_result(tmp_path, "a.txt")
    with pytest.raises(InputFileError, match="no manifest of stiffopt"):
        write(tmp_path, a="three")
    assert (tmp_path / "a.txt").read_text() == "one"


def test_no_space_left(tmp_path, monkeypatch):
    from stiffopt.files import atomic_write

    write(tmp_path, a="old")
    full = Path("/dev/full").open("wb", buffering=0)  # noqa: SIM115
    monkeypatch.setattr(folders.os, "fdopen", lambda *_: full)
    with (
        pytest.raises(InputFileError, match=r"a\.txt: cannot be written: No space left") as error,
        output_folder(tmp_path, "solve") as stage,
    ):
        atomic_write(stage / "a.txt", "new")
    assert error.value.path == str(tmp_path / "a.txt")
    monkeypatch.undo()
    assert tree(tmp_path) == {"a.txt": "old"}


def test_ctrl_c_waits_for_an_answer_that_is_being_written(tmp_path, capsys):
    with output_folder(tmp_path, "solve") as stage, defer_while_writing():
        signal.raise_signal(signal.SIGINT)
        (stage / "a.txt").write_text("new")
    assert tree(tmp_path) == {"a.txt": "new"}
    assert "Ctrl-C again throws it away" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_ctrl_c_throws_the_answer_away(tmp_path):
    def twice():
        with output_folder(tmp_path, "solve") as stage, defer_while_writing():
            (stage / "a.txt").write_text("new")
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        twice()
    assert tree(tmp_path) == {}


def test_no_space_in_the_middle_of_a_report(tmp_path):
    """Files of more than 4 kB cannot be written: the table can, the page cannot."""
    from benchmarks.reliability.mutants import alone, called

    command = ["stiffness", "er3a_c60", "--out", str(tmp_path / "out")]

    def cramped():
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        return called(command)

    assert alone(cramped, tmp_path) == ("told", "")
    assert list(tmp_path.iterdir()) == []
    write(tmp_path / "out", "stiffness", a="old")
    assert alone(cramped, tmp_path) == ("told", "")
    assert tree(tmp_path / "out") == {"a.txt": "old"}


@pytest.mark.parametrize("place", ["/proc/out", "/dev/null", "/sys/out"])
def test_where_nothing_can_be_written(place):
    with (
        pytest.raises(InputFileError, match="cannot be written"),
        output_folder(Path(place), "solve"),
    ):
        pass


def test_in_the_working_folder_only_own_files_move(tmp_path, monkeypatch):
    """`--out .` among files of the user: those stay the same files, and nothing is left beside."""
    home = tmp_path / "home"
    (home / "project").mkdir(parents=True)
    (home / "project" / "model.step").write_text("mine")
    (home / "notes.txt").write_text("mine")
    monkeypatch.chdir(home)
    before = {p: p.lstat().st_ino for p in home.rglob("*")}
    write(Path("."), a="one")
    write(Path("."), b="two")
    assert {p: p.lstat().st_ino for p in before} == before
    assert tree(home) == {"b.txt": "two", "notes.txt": "mine", "project/model.step": "mine"}
    assert os.listdir(tmp_path) == ["home"]


def test_a_stage_of_a_folder_that_was_replaced_is_cleared(tmp_path):
    """Deleted or exchanged since the kill: what was to come belongs to another state of it."""
    path = tmp_path / "out"
    write(path, a="old")
    assert killed(10, lambda: write(path, a="new"))
    assert (tmp_path / ".out.stiffopt" / MANIFEST).is_file()
    for each in path.iterdir():
        each.unlink()
    write(path, "preload", b="of somebody else")
    assert tree(path) == {"b.txt": "of somebody else"}
    assert hidden(path) == []


def test_what_another_user_left_is_told(tmp_path, monkeypatch):
    write(tmp_path / "out", a="old")
    (tmp_path / ".out.stiffopt").mkdir()
    check_result(tmp_path / "out", "a.txt")  # may be at work
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    with pytest.raises(InputFileError, match="of another user"):
        write(tmp_path / "out", a="new")


def test_a_name_that_no_manifest_may_list_changes_nothing(tmp_path):
    write(tmp_path, a="old")
    with pytest.raises(InputFileError, match="Rename its source"):
        write(tmp_path, **{"a\\b": "new"})
    assert tree(tmp_path) == {"a.txt": "old"}
