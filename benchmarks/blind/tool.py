"""The tool on one case: its own process, its own folder, a limit of time."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from .store import Store, whole_folder, write_json

SCRIPT = Path(__file__).with_name("sealed_tool.py")
# What is for people: the page and the design of the next motion change nothing in the answer.
LEFT_OUT = ("--no-report", "--no-experiment")
TIMEOUT = 900.0  # [s]
POLL = 0.05  # [s]


def answer(name: str, store: Store, timeout: float, stop: threading.Event) -> str | None:
    """Diagnose one case and keep what came of it; the status, None when interrupted.

    The process gets a copy of the case under a neutral name, and none of this one's environment.
    """
    if store.answered(name):
        return "ok"
    with tempfile.TemporaryDirectory(prefix="recordings-") as place:
        folder = Path(place).resolve()
        shutil.copytree(store.case(name), folder / "case")
        measured = _run(folder, timeout, stop)
        if measured is None:
            return None
        out = folder / "answer"
        out.mkdir(exist_ok=True)
        (folder / "stdout.txt").replace(out / "stdout.txt")
        (folder / "stderr.txt").replace(out / "stderr.txt")
        if measured["status"] == "ok" and not (out / "diagnosis.json").exists():
            measured["status"] = "failed"
        with whole_folder(store.answer(name)) as partial:
            shutil.copytree(out, partial, dirs_exist_ok=True)
            write_json(partial / "time.json", {"id": name, **measured})
    return str(measured["status"])


def _run(folder: Path, timeout: float, stop: threading.Event) -> dict[str, object] | None:
    environment = {
        "PATH": "/usr/bin:/bin",
        "HOME": str(folder),
        "TMPDIR": str(folder),
        "LANG": "C.UTF-8",
        "COLUMNS": "160",
        **{f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")},
    }
    begin = time.monotonic()
    with (folder / "stdout.txt").open("wb") as out, (folder / "stderr.txt").open("wb") as err:
        process = subprocess.Popen(
            [sys.executable, "-I", str(SCRIPT), "diagnose", "case", "--out", "answer", *LEFT_OUT],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,
        )
        state = "ok"
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            late = time.monotonic() - begin > timeout
            if late or stop.is_set():
                state = "timeout" if late else "interrupted"
                process.kill()
                _, status, usage = os.wait4(process.pid, 0)
                break
            time.sleep(POLL)
        process.returncode = code = os.waitstatus_to_exitcode(status)
    if state == "interrupted":
        return None
    refused = [
        line.removeprefix("refused: ")
        for line in (folder / "stderr.txt").read_text(errors="replace").splitlines()
        if line.startswith("refused: ")
    ]
    if state == "ok" and (code != 0 or refused):
        state = "failed"
    return {
        "seconds": time.monotonic() - begin,
        "cpu": usage.ru_utime + usage.ru_stime,
        "memory": usage.ru_maxrss * 1024,
        "status": state,
        "code": code,
        "refused": refused,
    }
