"""Folders for results: a command's files appear together, and a manifest says which they are.

Files are written into a hidden folder inside (`.stiffopt/new`). When all of them are whole, those
of the earlier answer go out, then the new ones come in, the manifest last: no moment shows both. A
list of what goes and comes is kept meanwhile, so that whoever next uses the folder ends what a
killed process had begun, or clears what it had not. A lock keeps two processes apart. Files that no
manifest lists, or that were changed since, are nobody's to overwrite: they keep their content under
another name.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

from stiffopt.errors import InputFileError
from stiffopt.files import atomic_write, check_file, load_json
from stiffopt.interrupts import uninterrupted

MANIFEST = "manifest.json"
# Folders that this process has written, in order.
written: list[Path] = []
# Inside the folder: lock, files to come, files that went, and the list of both.
_DESK, _NEW, _OLD, _LOCK, _PLAN, _HALF = ".stiffopt", "new", "old", "lock", "plan", "half"
_KEPT = ".kept"


@contextmanager
def output_folder(
    path: Path, command: str, *, of: str = "", maybe: Sequence[str] = ()
) -> Iterator[Path]:
    """A hidden folder to write into, tried before any long work; its files then appear in `path`.

    What ends with an exception changes nothing, and folders that were made for it are removed.

    Parameters
    ----------
    path : Path
    command : str
        That writes: files of its earlier answer make place for the new.
    of : str
        Command whose answer these files go with; a new answer of that takes them away too.
    maybe : sequence of str
        Files that it does not always write: without them, none of an earlier version stays.

    Raises
    ------
    InputFileError
        The folder cannot be written, or another process is writing into it.
    """
    if "\0" in str(path):
        raise InputFileError(repr(str(path)), "", "is no name of a folder.")
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        with ExitStack() as calm, _desk(path) as desk:
            _listed(path)  # a manifest of somebody else is told before any long work
            stage = desk / _NEW
            stage.mkdir()
            try:
                yield stage
            except InputFileError as error:
                raise _from_stage(error, stage, path) from error
            calm.enter_context(uninterrupted())
            _switch(path, desk, command, of, maybe)
            written.append(path)
    except BaseException:
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise


def check_result(folder: Path, *names: str) -> None:
    """Raise `InputFileError` unless files of a result folder are what one command wrote together.

    A folder without manifest, from an earlier version or written in Python, is taken as it is.
    """
    if any((folder / _DESK / name).exists() for name in (_PLAN, _HALF)):
        with _desk(folder):
            pass  # what a killed process had begun is ended on the way
    listed = _listed(folder)
    if not listed:
        return
    writers = {listed[name]["by"] for name in names if name in listed}
    for name in names:
        path = folder / name
        if name not in listed and path.exists():
            raise InputFileError(
                path, "", f"is of another run than the rest of this folder: {MANIFEST} does not "
                "list it. Make the result anew."
            )  # fmt: skip
        if name in listed and path.exists() and _hash(path) != listed[name]["sha256"]:
            raise InputFileError(
                path, "", f"was changed since `stiffopt {listed[name]['by']}` wrote it: {MANIFEST} "
                "has another hash. Make the result anew."
            )  # fmt: skip
    if len(writers) > 1:
        raise InputFileError(
            folder, "", f"its files are of different commands: {', '.join(sorted(writers))}."
        )


@contextmanager
def _desk(path: Path) -> Iterator[Path]:
    """The hidden folder, locked, and free of what killed processes left; removed at the end."""
    desk = path / _DESK
    try:
        lock = _locked(desk, path)
        try:
            _finish(path, desk)
        except BaseException:
            os.close(lock)
            raise
    except OSError as error:
        raise InputFileError(
            path, "", f"the folder cannot be written: {error.strerror}. Give another as --out."
        ) from error
    try:
        yield desk
    finally:
        _clear(desk)
        # While it is locked: whoever waits for this file finds that it is no longer the one there.
        with suppress(OSError):
            (desk / _LOCK).unlink()
            desk.rmdir()
        os.close(lock)


def _locked(desk: Path, path: Path) -> int:
    """Descriptor of the lock file, which this process holds from now on."""
    while True:
        desk.mkdir(parents=True, exist_ok=True)
        try:
            lock = os.open(desk / _LOCK, os.O_RDWR | os.O_CREAT, 0o666)
        except FileNotFoundError:  # another process has just removed the folder
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(lock), os.stat(desk / _LOCK)):
                return lock
        except FileNotFoundError:
            pass
        except BlockingIOError as error:
            os.close(lock)
            raise InputFileError(
                path, "", "another stiffopt is writing into this folder. Wait for it, or give "
                "another as --out."
            ) from error  # fmt: skip
        except OSError:  # a file system without locks
            return lock
        os.close(lock)


def _finish(path: Path, desk: Path) -> None:
    """End what a killed process had begun to put in place; clear what it had not."""
    if (desk / _PLAN).exists() or (desk / _HALF).exists():
        _carry_out(path, desk)
    _clear(desk)


def _clear(desk: Path) -> None:
    """Remove everything but the lock; nothing where a plan could not be carried out."""
    held = {each.name: each for each in desk.iterdir()} if desk.is_dir() else {}
    if _PLAN in held or _HALF in held:
        return
    for name, each in held.items():
        if each.is_dir():
            shutil.rmtree(each, ignore_errors=True)
        elif name != _LOCK:
            with suppress(OSError):
                each.unlink()


def _switch(path: Path, desk: Path, command: str, of: str, maybe: Sequence[str]) -> None:
    """Files of the stage take the place of the earlier answer."""
    stage = desk / _NEW
    coming = sorted(p.relative_to(stage).as_posix() for p in stage.rglob("*") if p.is_file())
    listed = _listed(path)
    going = {
        name
        for name, entry in listed.items()
        if name in coming or entry["by"] == command or entry.get("of") == command
    }
    # What is in the way and not as a manifest has it is the user's.
    users = [
        name
        for name in sorted({*going, *coming, *(set(maybe) - set(listed))})
        if (path / name).is_file()
        and (name not in listed or _hash(path / name) != listed[name]["sha256"])
    ]
    files = {name: entry for name, entry in listed.items() if name not in going}
    for name in coming:
        files[name] = {"by": command, "sha256": _hash(stage / name)} | ({"of": of} if of else {})
    document = {"schema": 1, "files": dict(sorted(files.items()))}
    atomic_write(stage / MANIFEST, json.dumps(document, indent=1) + "\n")
    aside = {name: _free(path, name) for name in users}
    out = [*sorted(going - set(users)), MANIFEST]
    plan = {"kept": aside, "out": out, "in": [*coming, MANIFEST]}
    for name, kept in aside.items():
        print(f"stiffopt: {path / name} was not written by stiffopt, or was changed since: it is "
              f"kept as {kept}.", file=sys.stderr)  # fmt: skip
    atomic_write(desk / _PLAN, json.dumps(plan))
    _carry_out(path, desk)


def _carry_out(path: Path, desk: Path) -> None:
    """First the old out, then the new in; begun anew after a kill, each step finds its place."""
    if (desk / _PLAN).exists():
        plan = json.loads((desk / _PLAN).read_text())
        for name, kept in plan["kept"].items():
            with suppress(FileNotFoundError):
                os.replace(path / name, path / kept)
        for name in plan["out"]:
            (desk / _OLD / name).parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileNotFoundError):
                os.replace(path / name, desk / _OLD / name)
        os.replace(desk / _PLAN, desk / _HALF)
    plan = json.loads((desk / _HALF).read_text())
    for name in plan["in"]:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            os.replace(desk / _NEW / name, path / name)
    for name in plan["out"]:
        with suppress(OSError):  # a folder that has become empty
            parent = (path / name).parent
            if parent != path:
                parent.rmdir()
    (desk / _HALF).unlink()


def _listed(path: Path) -> dict[str, dict[str, Any]]:
    """Entries of a folder's manifest by file name; empty where there is none."""
    manifest = path / MANIFEST
    if not manifest.is_file():
        return {}
    document = load_json(manifest)
    files = document.get("files") if isinstance(document, dict) else None
    if not isinstance(files, dict):
        files = {"": None}
    sound = all(
        isinstance(entry, dict)
        and isinstance(entry.get("by"), str)
        and isinstance(entry.get("sha256"), str)
        and not PurePosixPath(name).is_absolute()
        and ".." not in PurePosixPath(name).parts
        for name, entry in files.items()
    )
    if not sound:
        raise InputFileError(manifest, "", "is no manifest of stiffopt. Remove or rename it.")
    return {name: dict(entry) for name, entry in files.items()}


def _hash(path: Path) -> str:
    check_file(path)
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _free(path: Path, name: str) -> str:
    """A name beside `name` that no file has."""
    number, kept = 1, name + _KEPT
    while (path / kept).exists():
        number += 1
        kept = f"{name}{_KEPT}{number}"
    return kept


def _from_stage(error: InputFileError, stage: Path, path: Path) -> InputFileError:
    """The error with the place where the file was to appear."""
    if Path(error.path).is_relative_to(stage):
        place = path / Path(error.path).relative_to(stage)
        return InputFileError(place, error.where, error.reason)
    return error
