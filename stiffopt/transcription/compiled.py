"""Compiled stage functions: made beside the first solve, kept for the next.

A library is named by a hash of all that it depends on: formula, derivatives, CasADi, compiler and
machine. It appears in the cache whole or not at all, and any number of processes may ask for it at
once. Without a C compiler, or with STIFFOPT_COMPILE=never, everything works the same, slower.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import casadi as ca

from stiffopt.transcription import node_derivatives, wide_code

# Of multiply and add in one the last digit would be another one than without a compiler.
_FLAGS = ("-O1", "-fPIC", "-shared", "-ffp-contract=off")
# The widest registers there are; not every compiler knows the word.
_NATIVE = ("-march=native",)
# Inputs of a numbered stage that are the same at all points: parameters and numbers.
SHARED = (1, 2)
_PACKAGES = Path(__file__).parents[2]

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


def library(function: ca.Function) -> Path | None:
    """Find the compiled form of a numbered stage; where there is none yet, have it made.

    Parameters
    ----------
    function : casadi.Function
        Of a `NumberedStage`.

    Returns
    -------
    Path or None
        None until it is made, which takes some seconds, and where it cannot be.
    """
    program = compiler()
    if program is None:
        return None
    formula = function.serialize()
    path = cache_folder() / f"stage-{_key(formula, program)}.so"
    # Without a place to keep it there is an answer all the same, only later.
    with contextlib.suppress(OSError):
        if path.exists():
            return path
        if path not in _started:
            path.parent.mkdir(parents=True, exist_ok=True)
            _start(path, formula, program)
    return None


def wait() -> None:
    """Wait for the compilers that this process has started."""
    for process in _started.values():
        process.wait()


def libraries() -> list[Path]:
    """All compiled functions of this user, the latest first."""
    found = cache_folder().glob("stage-*.so")
    return sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)


def clear() -> int:
    """Remove all compiled functions of this user; their number."""
    found = libraries()
    for path in [*found, *cache_folder().glob("stage-*.lock")]:
        path.unlink(missing_ok=True)
    for path in cache_folder().glob("stage-*.parts-*"):
        shutil.rmtree(path, ignore_errors=True)
    _started.clear()
    return len(found)


def make(path: Path, program: str) -> None:
    """Compile the formula that lies beside the library to be made.

    Parameters
    ----------
    path : Path
        Of the library; the formula lies beside it.
    program : str
        The C compiler.
    """
    with _held(path) as free:
        if not free or path.exists():
            return
        for left in path.parent.glob(f"{path.stem}.parts-*"):
            shutil.rmtree(left, ignore_errors=True)
        formula = path.with_suffix(".casadi")
        function = ca.Function.deserialize(formula.read_text(encoding="ascii"))
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f"{path.stem}.parts-") as parts:
            source, made = Path(parts) / "stage.c", Path(parts) / "stage.so"
            derivatives = node_derivatives.with_derivatives(function)
            source.write_text(wide_code.wide_code(derivatives, SHARED), encoding="ascii")
            _compile(program, source, made)
            made.replace(path)
        formula.unlink(missing_ok=True)


def _compile(program: str, source: Path, made: Path) -> None:
    command = [program, *_FLAGS, str(source), "-o", str(made), "-lm"]
    native = [program, *_NATIVE, *command[1:]]
    if subprocess.run(native, check=False, stdin=subprocess.DEVNULL).returncode:
        subprocess.run(command, check=True, stdin=subprocess.DEVNULL)


def _start(path: Path, formula: str, program: str) -> None:
    with _held(path) as free:
        if not free:
            return
        path.with_suffix(".casadi").write_text(formula, encoding="ascii")
    packages = os.pathsep.join(filter(None, (str(_PACKAGES), os.environ.get("PYTHONPATH"))))
    # -P: nothing that happens to lie in the working folder is run.
    _started[path] = subprocess.Popen(
        [sys.executable, "-P", "-m", __name__, str(path), program],
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


def _key(formula: str, program: str) -> str:
    made_by = [Path(str(each.__file__)).read_text() for each in (node_derivatives, wide_code)]
    machine = (platform.platform(), _processor())
    parts = (formula, *made_by, ca.CasadiMeta.version(), program, *_FLAGS, *_NATIVE, *machine)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


@functools.cache
def _processor() -> str:
    """What the processor can do: a cache may be shared by several."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="ascii", errors="ignore").splitlines():
            if line.startswith(("flags", "Features")):
                return line
    return platform.processor()


if __name__ == "__main__":
    os.nice(5)
    make(Path(sys.argv[1]), sys.argv[2])
