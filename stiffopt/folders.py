"""Result folders: files of a command appear together and are listed in a manifest.

Files are written to a hidden folder beside the target (inside it where the target's parent cannot
be written or is another file system). When all are whole, the files of the earlier answer are
removed and the new ones are renamed into place, the manifest last: no moment shows files of two
answers. An interrupted replacement is completed from the two manifests, whose names and hashes are
checked and refer to nothing outside the target. Files that no manifest lists, or that were
changed since, belong to the user: they keep their content under another name.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import stat
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from errno import ENOTDIR
from pathlib import Path
from typing import Any

from stiffopt.errors import InputFileError
from stiffopt.files import SCHEMA, atomic_write, load_json
from stiffopt.interrupts import ignore_interrupts

MANIFEST = "manifest.json"
# Result folders of this process, in order.
written: list[Path] = []
_LOCK_FILE, _INNER_STAGE, _KEPT_SUFFIX = ".stiffopt.lock", ".stiffopt.new", ".kept"
# In a stage that is complete: hash of the manifest that it replaces.
_READY_FILE = ".replaces"
# Working folder of earlier versions, with a list of moves that those carried out unchecked.
_OBSOLETE_FOLDER = ".stiffopt"
# Relative, without empty, hidden or parent folders, backslashes and control characters.
_PATH_PART_PATTERN = r"(?!\.)[^/\\\x00-\x1f\x7f-\x9f]+"
_FILE_NAME_PATTERN = re.compile(rf"{_PATH_PART_PATTERN}(/{_PATH_PART_PATTERN})*")
_COMMAND_PATTERN = re.compile(r"[a-z][a-z0-9 -]{0,60}")
_HASH_PATTERN = re.compile(r"[0-9a-f]{64}")
# Above any file that a command writes; hashing more takes seconds [bytes].
_MAX_FILE_SIZE = 2**30


@contextmanager
def output_folder(
    path: Path, command: str, *, of: str = "", maybe: Sequence[str] = ()
) -> Iterator[Path]:
    """Create a hidden folder to write into; its files appear in `path` at the end.

    Created before any long work, so that an unwritable folder is reported early. After an exception
    nothing has changed, and folders made for it are removed. Files of an earlier answer of
    `command` are replaced, and those that other commands wrote `of` it removed; earlier files named
    in `maybe`, which are not always written, are set aside. Raises `InputFileError` for a folder
    that cannot be written, is being written or contains entries that no command writes.
    """
    if "\0" in str(path):
        raise InputFileError(repr(str(path)), "", "is no name of a folder.")
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        with ExitStack() as calm, _folder_lock(path), _new_stage(path) as stage:
            _check_regular(path, *_manifest_entries(path))
            try:
                yield stage
            except InputFileError as error:
                raise _relocate_error(error, stage, path) from error
            calm.enter_context(ignore_interrupts())
            _finish_stage(path, stage, command, of, maybe)
            _put_in_place(path, stage)
            written.append(path)
    except BaseException:
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise


def check_result(folder: Path, *names: str, edited: bool = False) -> None:
    """Raise `InputFileError` unless files of a result folder were written together by one command.

    A folder without manifest, from an earlier version or written in Python, is taken as it is, but
    for links, pipes and devices. Files that a user may have `edited` need only be regular files,
    and those that the manifest does not list are not checked.
    """
    _check_control_files(folder)
    if any(_is_ready(stage, folder) for stage in _stage_paths(folder)):
        with _folder_lock(folder):
            _complete_interrupted(folder)
    listed = _manifest_entries(folder)
    if edited:
        _check_regular(folder, *(name for name in names if name in listed))
        return
    _check_regular(folder, *names)
    present = [name for name in names if is_regular(folder, name)]
    for name in present if listed else ():
        path = folder / name
        if name not in listed:
            raise InputFileError(
                path, "", f"is of another run than the rest of this folder: {MANIFEST} does not "
                "list it. Make the result again."
            )  # fmt: skip
        if _hash_file(folder, name) != listed[name]["sha256"]:
            raise InputFileError(
                path, "", f"was changed since `stiffopt {listed[name]['by']}` wrote it: {MANIFEST} "
                "has another hash. Make the result again."
            )  # fmt: skip
    writers = {listed[name]["by"] for name in names if name in listed}
    if len(writers) > 1:
        raise InputFileError(
            folder, "", f"its files are of different commands: {', '.join(sorted(writers))}."
        )


def is_regular(folder: Path, name: str) -> bool:
    """Return whether a name is a regular file that is reached from the folder without links."""
    return _blocking_path(folder, name) == name and stat.S_ISREG(_file_mode(folder / name))


def _file_mode(path: Path) -> int:
    """Kind and permissions of a path without following links; 0 where it does not exist."""
    try:
        return path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return 0


def _check_regular(folder: Path, *names: str) -> None:
    """Raise `InputFileError` where a name exists, but is no regular file of the folder itself."""
    for name in names:
        if _blocking_path(folder, name) and not is_regular(folder, name):
            raise InputFileError(
                folder / name, "", "is reached through a link, or is a folder, pipe or device; a "
                "result's files are regular files of its own folder. Remove or rename it."
            )  # fmt: skip
        if is_regular(folder, name) and (folder / name).stat().st_size > _MAX_FILE_SIZE:
            raise InputFileError(
                folder / name, "", f"is larger than {_MAX_FILE_SIZE / 2**30:.0f} GiB, which no "
                "file of a result is. Remove or rename it."
            )  # fmt: skip


def _check_control_files(path: Path) -> None:
    """Raise `InputFileError` where lock or stage are not of the kind that this version makes."""
    if _file_mode(path / _OBSOLETE_FOLDER):
        raise InputFileError(
            path / _OBSOLETE_FOLDER, "", "was left by an earlier version of stiffopt that was "
            "killed, or came with a foreign folder; nothing of it is carried out. Remove it and "
            "make the result again."
        )  # fmt: skip
    for each, is_kind in (
        (path / _LOCK_FILE, stat.S_ISREG),
        *((stage, stat.S_ISDIR) for stage in _stage_paths(path)),
    ):
        if _file_mode(each) and not is_kind(_file_mode(each)):
            raise InputFileError(
                each, "", "is a link or of another kind than stiffopt makes under this name. "
                "Remove it."
            )  # fmt: skip


@contextmanager
def _folder_lock(path: Path) -> Iterator[None]:
    """Hold the lock of a folder, created if missing."""
    from filelock import FileLock, Timeout

    lock = FileLock(path / _LOCK_FILE, timeout=0)
    try:
        try:
            path.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            path.stat()  # names a loop of links
            raise NotADirectoryError(ENOTDIR, os.strerror(ENOTDIR), path) from None
        _check_control_files(path)
        held = lock.acquire()
    except Timeout as error:
        raise InputFileError(
            path, "", "another stiffopt is writing into this folder. Wait for it, or give another "
            "as --out."
        ) from error  # fmt: skip
    except OSError as error:
        raise _not_writable(path, error) from error
    with held:
        try:
            yield
        finally:
            # Remove it while held: a process that opened it meanwhile sees that it was replaced.
            with suppress(OSError):
                (path / _LOCK_FILE).unlink()


def _not_writable(path: Path, error: OSError) -> InputFileError:
    return InputFileError(
        path, "", f"the folder cannot be written: {error.strerror}. Give another as --out."
    )


def _stage_paths(path: Path) -> tuple[Path, Path]:
    """Folders in which new files are written: beside the target, or inside it."""
    real = Path(os.path.realpath(path))
    return real.parent / f".{real.name}.stiffopt", real / _INNER_STAGE


@contextmanager
def _new_stage(path: Path) -> Iterator[Path]:
    """Create an empty stage after completing or removing that of an interrupted process."""
    beside, inside = _stage_paths(path)
    try:
        _complete_interrupted(path)
        inside.mkdir(mode=0o700)
    except OSError as error:
        raise _not_writable(path, error) from error
    stage = inside
    # Fails where the parent cannot be written or files cannot be renamed from there.
    with suppress(OSError):
        stage = inside.rename(beside)
    try:
        yield stage
    finally:
        # A complete one stays: the next use of the folder moves it into place.
        if not _is_ready(stage, path):
            shutil.rmtree(stage, ignore_errors=True)


def _is_ready(stage: Path, path: Path) -> bool:
    """Return whether a stage is complete and replaces the answer that the folder holds."""
    if not (is_regular(stage, MANIFEST) and is_regular(stage, _READY_FILE)):
        return False
    with (stage / _READY_FILE).open("rb") as stream:
        return stream.read(65) == _hash_file(path, MANIFEST).encode()


def _complete_interrupted(path: Path) -> None:
    """Move the complete stage of an interrupted process into place; remove an incomplete one."""
    for stage in filter(_file_mode, _stage_paths(path)):
        if stage.lstat().st_uid != os.geteuid():
            raise InputFileError(
                stage, "", "was left by a stopped stiffopt of another user. Have it removed, or "
                "give another folder as --out."
            )  # fmt: skip
        if _is_ready(stage, path):
            _put_in_place(path, stage)
        shutil.rmtree(stage)


def _finish_stage(path: Path, stage: Path, command: str, of: str, maybe: Sequence[str]) -> None:
    """Write manifest and mark of a stage, which from then on replaces the earlier answer."""
    coming = sorted(p.relative_to(stage).as_posix() for p in stage.rglob("*") if p.is_file())
    listed = _manifest_entries(path)
    for name in coming:
        if not _FILE_NAME_PATTERN.fullmatch(name):
            raise InputFileError(
                path / name, "", "this name is hidden or has backslashes or control characters, "
                "which no result may have. Rename its source."
            )  # fmt: skip
    files = {
        name: entry
        for name, entry in listed.items()
        if command not in (entry["by"], entry.get("of"))
    }
    for name in coming:
        files[name] = {"by": command, "sha256": _hash_file(stage, name)} | (
            {"of": of} if of else {}
        )
    document = {"schema": SCHEMA, "files": dict(sorted(files.items()))}
    atomic_write(stage / MANIFEST, json.dumps(document, indent=1) + "\n")
    atomic_write(stage / _READY_FILE, _hash_file(path, MANIFEST))
    for name in sorted({*maybe} - {*coming, *listed}):
        _set_aside(path, name)


def _put_in_place(path: Path, stage: Path) -> None:
    """Remove the old answer, then rename the new one into place; repeatable after a kill."""
    new, old = _manifest_entries(stage), _manifest_entries(path)
    coming = {n for n, entry in new.items() if entry != old.get(n) or is_regular(stage, n)}
    for name in coming:
        if new[name]["sha256"] not in (_hash_file(stage, name), _hash_file(path, name)):
            raise InputFileError(
                stage, "", f"holds an answer that a stopped stiffopt left for {path}, whose {name} "
                "was changed or removed since. Remove this folder and make the result again."
            )  # fmt: skip
    for name in sorted(coming | (old.keys() - new.keys())):
        digest = _hash_file(path, name)
        if name in coming and not is_regular(stage, name) and digest == new[name]["sha256"]:
            continue  # in place already
        if digest and digest == old.get(name, {}).get("sha256"):
            (path / name).unlink()
        else:
            _set_aside(path, name)
    for name in sorted(coming):
        if is_regular(stage, name):
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(stage / name, path / name)
    for parent in {(path / name).parent for name in old.keys() - new.keys()} - {path}:
        with suppress(OSError):  # unless it has become empty
            parent.rmdir()
    os.replace(stage / MANIFEST, path / MANIFEST)


def _manifest_entries(path: Path) -> dict[str, dict[str, Any]]:
    """Entries of a folder's manifest by file name; empty where there is none."""
    manifest = path / MANIFEST
    _check_regular(path, MANIFEST)
    if not is_regular(path, MANIFEST):
        return {}
    document = load_json(manifest)
    files = document.get("files") if isinstance(document, dict) else None
    if not isinstance(files, dict):
        files = {"": None}
    sound = all(
        isinstance(entry, dict)
        and _COMMAND_PATTERN.fullmatch(str(entry.get("by")))
        and _COMMAND_PATTERN.fullmatch(str(entry.get("of", "none")))
        and _HASH_PATTERN.fullmatch(str(entry.get("sha256")))
        and _FILE_NAME_PATTERN.fullmatch(name)
        and name != MANIFEST
        for name, entry in files.items()
    )
    if not sound:
        raise InputFileError(manifest, "", "is no manifest of stiffopt. Remove or rename it.")
    return {name: dict(entry) for name, entry in files.items()}


def _hash_file(folder: Path, name: str) -> str:
    """SHA-256 of a regular file of a folder; empty where there is none."""
    if not is_regular(folder, name):
        return ""
    with (folder / name).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _blocking_path(folder: Path, name: str) -> str:
    """Name itself or the first of its parents that is no folder; empty where neither exists."""
    parts = name.split("/")
    for k in range(1, len(parts)):
        above = "/".join(parts[:k])
        if not stat.S_ISDIR(_file_mode(folder / above)):
            return above if _file_mode(folder / above) else ""
    return name if _file_mode(folder / name) else ""


def _set_aside(path: Path, name: str) -> None:
    """Rename the user's file or folder that occupies a name."""
    blocking = _blocking_path(path, name)
    if not blocking:
        return
    number, kept = 1, blocking + _KEPT_SUFFIX
    while _file_mode(path / kept):
        number += 1
        kept = f"{blocking}{_KEPT_SUFFIX}{number}"
    print(f"stiffopt: {path / blocking} was not written by stiffopt, or was changed since: it is "
          f"kept as {kept}.", file=sys.stderr)  # fmt: skip
    (path / blocking).rename(path / kept)


def _relocate_error(error: InputFileError, stage: Path, path: Path) -> InputFileError:
    """The error with the place where the file was to appear."""
    if Path(error.path).is_relative_to(stage):
        place = path / Path(error.path).relative_to(stage)
        return InputFileError(place, error.where, error.reason)
    return error
