"""The system's C compiler: libraries that it makes beside other work, kept for this user.

A library is named by a hash of all that it depends on. It appears in the cache whole or not at all,
and any number of processes may ask for it at once; one that was damaged since is made again.
Without a C compiler, or with STIFFOPT_COMPILE=never, everything works the same, slower. With
STIFFOPT_COMPILE=package only the package's own C code is compiled, once for all problems.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import functools
import hashlib
import os
import platform
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

# Of multiply and add in one the last digit would be another one than without a compiler.
_FLAGS = ("-fPIC", "-shared", "-ffp-contract=off")
# The widest registers there are; not every compiler knows the word.
_NATIVE = ("-march=native",)
_PACKAGES = Path(__file__).parents[1]
# Of one run of a compiler [s]: the longest took 40 s on a busy machine; it works beside others and
# would stay after them.
MAX_COMPILER_SECONDS = 300.0
# What names of libraries begin with, in a folder that may hold something else.
_KINDS = ("stage", "swings", "frontal", "bodies")

# Compilers at work for this process, by library; kept, or Python would complain of them.
_started: dict[Path, subprocess.Popen[bytes]] = {}


def cache_folder() -> Path:
    """Folder of this user's compiled functions: STIFFOPT_CACHE, else where caches are kept."""
    named = os.environ.get("STIFFOPT_CACHE")
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "stiffopt"


def compiler() -> str | None:
    """The C compiler, CC of the environment or `cc`; None where there is none or it is unwanted."""
    if os.environ.get("STIFFOPT_COMPILE") == "never":
        return None
    return shutil.which(os.environ.get("CC") or "cc")


def compiles(program: str) -> bool:
    """Whether a compiler makes a library that this process can load."""
    with tempfile.TemporaryDirectory() as folder:
        source, made = Path(folder) / "code.c", Path(folder) / "code.so"
        source.write_text("int one(void) { return 1; }\n", encoding="ascii")
        try:
            build(program, source, made, "-O0")
        except (OSError, subprocess.SubprocessError):
            return False
        return _loads(made)


def library(
    kind: str, given: str, made_by: Sequence[str] = (), module: str = __name__
) -> Path | None:
    """Find a library; where there is none yet, have it made beside other work.

    Parameters
    ----------
    kind : str
        What its name begins with, one of "stage", "swings", "frontal" and "bodies".
    given : str
        What it is made of; C code, if by this module.
    made_by : sequence of str
        What the library depends on besides.
    module : str
        Run as a script with the library's path and the compiler, to call `make`.

    Returns
    -------
    Path or None
        None until it is made, and where it cannot be.
    """
    program = compiler()
    if program is None:
        return None
    depends = (given, *made_by, program, *_FLAGS, *_NATIVE, platform.platform(), _processor())
    name = hashlib.sha256("\0".join(depends).encode()).hexdigest()[:32]
    path = cache_folder() / f"{kind}-{name}.so"
    # Without a place to keep it there is an answer all the same, only later.
    with contextlib.suppress(OSError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_private(path.parent):
            return None
        if _is_whole(path):
            return path if _is_private(path) and _loads(path) else None
        if path not in _started:
            _start(path, given, program, module)
    return None


def wait() -> None:
    """Wait for the compilers that this process has started."""
    for process in _started.values():
        process.wait()


def libraries() -> list[Path]:
    """All libraries of this user, the latest first."""
    found = [path for kind in _KINDS for path in cache_folder().glob(f"{kind}-*.so")]
    return sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)


def clear() -> int:
    """Remove all libraries of this user; their number."""
    found, folder = libraries(), cache_folder()
    for kind in _KINDS:
        beside = (path for end in ("lock", "given") for path in folder.glob(f"{kind}-*.{end}"))
        for path in [*found, *beside]:
            path.unlink(missing_ok=True)
        for path in folder.glob(f"{kind}-*.parts-*"):
            shutil.rmtree(path, ignore_errors=True)
    _started.clear()
    return len(found)


def make(path: Path, program: str, code: Callable[[str], str], optimise: str) -> None:
    """Compile what lies beside the library to be made.

    Parameters
    ----------
    path : Path
        Of the library.
    program : str
        The C compiler.
    code : callable
        C code of what was given.
    optimise : str
        Option of the compiler, such as -Og.
    """
    with _held(path) as free:
        if not free or _is_whole(path):
            return
        for left in path.parent.glob(f"{path.stem}.parts-*"):
            shutil.rmtree(left, ignore_errors=True)
        given = path.with_suffix(".given")
        parts = tempfile.TemporaryDirectory(dir=path.parent, prefix=f"{path.stem}.parts-")
        try:
            with parts as folder:
                source, made = Path(folder) / "code.c", Path(folder) / "code.so"
                source.write_text(code(given.read_text(encoding="ascii")), encoding="ascii")
                build(program, source, made, optimise)
                # First, for who finds the library looks for it.
                path.with_suffix(".lock").write_text(_digest(made), encoding="ascii")
                made.chmod(0o700)
                made.replace(path)
        finally:
            given.unlink(missing_ok=True)


def build(program: str, source: Path, made: Path, optimise: str) -> None:
    """Run the C compiler."""
    command = [program, optimise, *_FLAGS, str(source), "-o", str(made), "-lm"]
    native = [program, *_NATIVE, *command[1:]]
    if _run_bounded(native):
        code = _run_bounded(command)
        if code:
            raise subprocess.CalledProcessError(code, command)


def _run_bounded(command: Sequence[str]) -> int:
    """Run a compiler; return its exit code, or end it and the processes that it has started."""
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        return process.wait(MAX_COMPILER_SECONDS)
    except BaseException:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise


def _start(path: Path, given: str, program: str, module: str) -> None:
    with _held(path) as free:
        if not free:
            return
        path.with_suffix(".given").write_text(given, encoding="ascii")
    packages = os.pathsep.join(filter(None, (str(_PACKAGES), os.environ.get("PYTHONPATH"))))
    # -P: nothing that happens to lie in the working folder is run.
    _started[path] = subprocess.Popen(
        [sys.executable, "-P", "-m", module, str(path), program],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        # Ctrl-C ends the solve, not what later solves will use.
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": packages},
    )


@contextlib.contextmanager
def _held(path: Path) -> Iterator[bool]:
    """Hold the lock of a library, if it is free; the system frees it when a process dies."""
    with path.with_suffix(".lock").open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True


@functools.cache
def _is_private(path: Path) -> bool:
    """Return whether only this user can have written a file or folder; say so once if not."""
    state = path.stat()
    if state.st_uid == os.geteuid() and not state.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return True
    print(f"stiffopt: {path} is not used: others may have written it. Remove it, or set "
          "STIFFOPT_CACHE to a folder of your own.", file=sys.stderr)  # fmt: skip
    return False


def _is_whole(path: Path) -> bool:
    """Whether a library is there as it was made; to load a part of one may end the process."""
    with contextlib.suppress(FileNotFoundError):
        state = path.stat()
        return _is_as_made(path, (state.st_ino, state.st_size, state.st_mtime_ns))
    return False


@functools.cache
def _is_as_made(path: Path, state: tuple[int, ...]) -> bool:
    return path.with_suffix(".lock").read_text(encoding="ascii", errors="ignore") == _digest(path)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@functools.cache
def _loads(path: Path) -> bool:
    """Whether the system takes it: not from a disk that may run nothing."""
    with contextlib.suppress(OSError):
        ctypes.CDLL(str(path))
        return True
    return False


@functools.cache
def _processor() -> str:
    """What the processor can do: a cache may be shared by several."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="ascii", errors="ignore").splitlines():
            if line.startswith(("flags", "Features")):
                return line
    return platform.processor()


if __name__ == "__main__":
    make(Path(sys.argv[1]), sys.argv[2], lambda code: code, "-O2")
