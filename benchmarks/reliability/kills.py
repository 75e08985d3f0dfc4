"""A solve that is killed or interrupted at random times, over and over into one folder.

Looked at after each: the folder must hold one whole answer, or the beginning of one alone, and
never files of two; a user's own file must stay.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from benchmarks.reliability.commands import ROOT
from stiffopt.folders import MANIFEST

_PROBLEM = """
schema = 1
kind = "trajectory"
title = "{title}"
robot = "{robot}"

[motion]
start = {{ joints = [0.0, 0.0] }}
end = {{ joints = [1.0, {end}] }}
duration = "1 s"

[[minimise]]
objective = "torque_squared"

[method]
intervals = 8
"""


def hashes(folder: Path) -> dict[str, str]:
    """Hash of every file that a user sees, by name; without the manifest."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and ".stiffopt" not in path.parts and path.name != MANIFEST
    }


def judged(folder: Path, before: dict[str, str]) -> str:
    """How a folder looks: "whole", "begun" (of one answer alone) or "mixed"."""
    seen = hashes(folder)
    if (folder / MANIFEST).is_file():
        listed = json.loads((folder / MANIFEST).read_text())["files"]
        whole = {name: entry["sha256"] for name, entry in listed.items()} == seen
        return "whole" if whole else "mixed"
    old = {name for name, digest in seen.items() if before.get(name) == digest}
    return "mixed" if old and len(old) < len(seen) else "begun"


def ended(place: Path, count: int, sign: signal.Signals, seed: int = 1) -> Counter[str]:
    """Verdicts on a folder after each of `count` solves that a signal ended."""
    choice = random.Random(seed)
    out, notes = place / "out", place / "out" / "notes.txt"
    problems = []
    for k in range(2):
        path = place / f"p{k}.toml"
        path.write_text(
            _PROBLEM.format(
                title=f"number {k}",
                robot=ROOT / "problems" / "two_link_robot.toml",
                end=0.5 + k / 4,
            )
        )
        problems.append(path)
    began = time.monotonic()
    _run(problems[0], out, None, sign)
    usual = time.monotonic() - began
    found: Counter[str] = Counter()
    for k in range(count):
        before = hashes(out)
        notes.write_text("mine")
        code, error = _run(problems[(k + 1) % 2], out, choice.uniform(0.1, 1.1) * usual, sign)
        kept = notes.is_file() and notes.read_text() == "mine"
        notes.unlink(missing_ok=True)
        verdict = judged(out, before) if kept else "user's file lost"
        if "Traceback" in error:
            verdict = "traceback"
            print(error, flush=True)
        said = sign is signal.SIGINT and "nothing was written" in error
        if said and hashes(out) != before:
            verdict = "said nothing was written"
        found[verdict] += 1
        found[f"exit {code}"] += 1
        print(k, verdict, code, flush=True)
    code, error = _run(problems[0], out, None, sign)
    found["left behind"] += sum(path.name.startswith(".") for path in out.rglob("*"))
    found[f"at the end {judged(out, {})}, exit {code}"] += 1
    return found


def _run(problem: Path, out: Path, seconds: float | None, sign: signal.Signals) -> tuple[int, str]:
    process = subprocess.Popen(
        [sys.executable, "-m", "stiffopt", "solve", str(problem), "--out", str(out), "--quiet"],
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # Jobs in the background of a shell ignore the signal, and pass that on.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        _, error = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(sign)
        _, error = process.communicate(timeout=120)
    return process.returncode, error
