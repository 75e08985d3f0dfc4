"""Compiled stage functions: made beside the first solve, kept for the next.

A library is named by a hash of all that it depends on: formula, derivatives, CasADi, compiler and
machine. It appears in the cache whole or not at all, and any number of processes may ask for it at
once. Without a C compiler, or with STIFFOPT_COMPILE=never, everything works the same, slower.
"""

from __future__ import annotations

import contextlib
import fcntl
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

from stiffopt.transcription import node_derivatives

_FLAGS = ("-O1", "-fPIC", "-shared")
# Lines of a generated function that are compiled as one.
_LONGEST = 1000
_ARGUMENTS = "const casadi_real** arg, casadi_real** res, casadi_real* w"
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
            # Thousands of local variables would cost the compiler more than all else.
            generator = ca.CodeGenerator("stage.c", {"avoid_stack": True})
            for each in node_derivatives.with_derivatives(function):
                generator.add(each)
            generator.generate(f"{parts}/")
            source, made = Path(parts) / "stage.c", Path(parts) / "stage.so"
            source.write_text(_in_parts(source.read_text(encoding="utf-8")), encoding="utf-8")
            command = [program, *_FLAGS, str(source), "-o", str(made), "-lm"]
            subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
            made.replace(path)
        formula.unlink(missing_ok=True)


def _in_parts(code: str) -> str:
    """The same C code in functions of bounded length, for which a compiler needs less memory.

    All that a generated function knows stands in its arguments, so it may be cut at any line.
    """
    lines: list[str] = []
    body: list[str] = []
    head = ""
    for line in code.splitlines():
        if line.startswith("static int casadi_f") and line.endswith("{"):
            head, body = line, []
        elif not head:
            lines.append(line)
        elif line == "  return 0;":
            calls = []
            for k in range(0, len(body), _LONGEST):
                part = f"{head.split()[2].split('(')[0]}_{k}"
                lines.append(f"static __attribute__((noinline)) void {part}({_ARGUMENTS}) {{")
                lines += [*body[k : k + _LONGEST], "}"]
                calls.append(f"  {part}(arg, res, w);")
            lines += [head, *calls, line]
            head = ""
        else:
            body.append(line)
    return "\n".join(lines)


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
    derivatives = Path(node_derivatives.__file__).read_text(encoding="utf-8")
    parts = (formula, derivatives, ca.CasadiMeta.version(), program, *_FLAGS, platform.platform())
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


if __name__ == "__main__":
    os.nice(5)
    make(Path(sys.argv[1]), sys.argv[2])
