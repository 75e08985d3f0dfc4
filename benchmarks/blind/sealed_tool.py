"""The tool in a process that can open what it was given, and nothing else of the machine's.

Run as a script, with the folder of the case as working folder:
    python -I sealed_tool.py diagnose case --out answer
An audit hook, which cannot be taken off again, ends the process at any other access.
"""

from __future__ import annotations

import os
import runpy
import site
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]  # of the commit under test
LISTED = {"os.listdir", "os.scandir"}
FORBIDDEN = {
    "subprocess.Popen",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.fork",
    "socket.connect",
    "socket.getaddrinfo",
}
SYSTEM = ("/usr", "/lib", "/lib64", "/etc", "/dev", "/proc/self", "/proc/cpuinfo", "/sys")
REFUSED = 77  # exit status


def _real(path: Any) -> str:
    return os.path.realpath(os.fsdecode(path))


def _inside(path: str, folders: tuple[str, ...]) -> bool:
    return any(path == folder or path.startswith(folder + os.sep) for folder in folders)


def seal() -> None:
    """From here on this process is held to its folder, the interpreter and the package."""
    package = find_spec("stiffopt")
    if package is None or not package.submodule_search_locations:
        sys.exit("stiffopt is not installed")
    here = _real(os.curdir)
    allowed = tuple(
        _real(p)
        for p in {
            here,
            *package.submodule_search_locations,
            # Entry points of an editable installation.
            *ROOT.glob("*.egg-info"),
            *site.getsitepackages(),
            *sysconfig.get_paths().values(),
            sys.prefix,
            sys.base_prefix,
            *SYSTEM,
        }
    )
    # The import system lists the folders that it searches.
    searched = {_real(p) for p in sys.path if p}

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if event in FORBIDDEN:
            _end(event)
        if event != "open" and event not in LISTED:
            return
        path = arguments[0]
        if path is None:
            path = os.curdir
        if isinstance(path, int):
            return
        real = _real(path)
        if event in LISTED and real in searched:
            return
        if not _inside(real, allowed):
            _end(real)

    sys.addaudithook(watch)


def _end(what: str) -> None:
    os.write(2, f"refused: {what}\n".encode(errors="replace"))
    os._exit(REFUSED)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    seal()
    sys.argv[0] = "stiffopt"
    runpy.run_module("stiffopt", run_name="__main__", alter_sys=True)
