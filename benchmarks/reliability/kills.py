"""Commands that are killed or interrupted at random times, over and over into one folder each.

Looked at after each: the folder must hold one whole answer, or the beginning of one alone, and
never files of two; a user's own file must stay. What Ctrl-C ends after an optimisation has begun,
or a search has found something, must leave an answer.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.reliability.commands import ROOT
from benchmarks.reliability.subject import RECORDED
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
_SWEEP = """
schema = 1
kind = "sweep"
title = "{title}"
base = "{base}"

[grid]
"motion.duration" = ["0.9 s", "1.0 s", "1.1 s"]
"""
# The command line, which makes a file when the work that Ctrl-C shall keep has begun.
_MARKED = """
import pathlib, signal, sys
signal.signal(signal.SIGINT, lambda *_: sys.exit(130))  # while this file imports what it marks
import stiffopt.solver.ipopt as ipopt, stiffopt.discovery.search.search as search
mark = pathlib.Path(sys.argv.pop(1))
def marked(work):
    def begun(*arguments, **named):
        mark.touch()
        return work(*arguments, **named)
    return begun
ipopt.IpoptSolver.solve = marked(ipopt.IpoptSolver.solve)
search.prune_effects = marked(search.prune_effects)  # something has been found
from stiffopt.__main__ import main
signal.signal(signal.SIGINT, signal.default_int_handler)
main()
"""


@dataclass(frozen=True)
class _Work:
    """A command by turns with one of two inputs, into one folder."""

    name: str
    turns: tuple[tuple[str, ...], ...]
    out: Path
    mark: Path

    def run(
        self, turn: int, seconds: float | None = None, sign: signal.Signals = signal.SIGKILL
    ) -> tuple[int, str, bool]:
        """Exit code, stderr and whether what shall be kept had begun when the signal came."""
        self.mark.unlink(missing_ok=True)
        process = subprocess.Popen(
            [sys.executable, "-c", _MARKED, str(self.mark), *self.turns[turn % 2],
             "--out", str(self.out), "--quiet"],
            env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            # Jobs in the background of a shell ignore the signal, and pass that on.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )  # fmt: skip
        begun = False
        try:
            _, error = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            begun = self.mark.exists()
            process.send_signal(sign)
            _, error = process.communicate(timeout=120)
        return process.returncode, error, begun


def hashes(folder: Path) -> dict[str, str]:
    """Hash of every file that a user sees, by name; without the manifest and cases of a sweep."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and path.name != MANIFEST and "cases" not in path.parts
        if not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }


def judged(folder: Path, before: dict[str, str]) -> str:
    """How a folder looks: "whole", "begun" (of one answer alone) or "mixed".

    The manifest changes last: until then it lists the answer `before`, of which a part may be gone,
    or all of it and a part of the new answer be there.
    """
    for case in folder.glob("cases/*.json"):
        if json.loads(case.read_text())["key"] != case.stem:
            return "mixed"
    seen, listed = hashes(folder), {}
    if (folder / MANIFEST).is_file():
        files = json.loads((folder / MANIFEST).read_text())["files"]
        listed = {name: entry["sha256"] for name, entry in files.items()}
        if listed == seen:
            return "whole"
    old = {name for name, digest in seen.items() if before.get(name) == digest}
    sound = listed in ({}, before) and len(old) in (0, len(seen))
    return "begun" if sound else "mixed"


def ended(
    place: Path,
    number: int,
    sign: signal.Signals,
    *,
    first: int = 0,
    record: Path | None = None,
    seconds: float = math.inf,
    kinds: Sequence[str] = ("solve", "preload", "diagnose", "sweep"),
) -> Counter[str]:
    """Verdicts on the folders after each of so many commands that a signal ended, kinds in turn.

    `first`, `record` and `seconds` as those of `mutants.count`.
    """
    works = [each for each in _works(place) if each.name in kinds]
    usual = {work.name: _timed(work) for work in works}
    known = record.read_text().splitlines() if record is not None and record.is_file() else []
    done = {tuple(line.split("\t")[:2]) for line in known}
    found: Counter[str] = Counter()
    began = time.monotonic()
    for k in range(first, first + number):
        work = works[k % len(works)]
        if (work.name, str(k)) in done:
            continue
        if time.monotonic() - began > seconds:
            break
        after = random.Random(f"{sign} {k}").uniform(0.1, 1.1) * usual[work.name]
        verdict, code = _ended(work, k, after, sign)
        found[verdict] += 1
        found[f"exit {code}"] += 1
        line = f"{work.name}\t{k}\t{verdict}\t{after:.2f}\texit {code}"
        print(line, flush=True)
        if record is not None:
            with record.open("a") as stream:
                stream.write(line + "\n")
    for work in works:
        code, *_ = work.run(0)
        left = (*work.out.rglob(".*"), *place.glob(f".{work.out.name}.*"))
        found["left behind"] += len(left)
        found[f"at the end {judged(work.out, {})}, exit {code}"] += 1
    return found


def _ended(work: _Work, k: int, after: float, sign: signal.Signals) -> tuple[str, int]:
    """Verdict on the folder of a command that a signal ended, and the exit code."""
    before, notes = hashes(work.out), work.out / "notes.txt"
    notes.write_text("mine")
    if k % 8 < 4:  # a sweep begins anew, or goes on with the cases that are there
        shutil.rmtree(work.out / "cases", ignore_errors=True)
    # Each kind by turns with its two inputs, whatever the number of kinds.
    code, error, begun = work.run(k // 4 + k, after, sign)
    kept = notes.is_file() and notes.read_text() == "mine"
    notes.unlink(missing_ok=True)
    verdict = judged(work.out, before) if kept else "user's file lost"
    if "Traceback" in error:
        verdict = "traceback"
        print(error, flush=True)
    if sign is signal.SIGINT and "nothing was written" in error:
        if hashes(work.out) != before:
            verdict = "said nothing was written"
        elif begun:
            verdict = "what was found is lost"
    return verdict, code


def _timed(work: _Work) -> float:
    began = time.monotonic()
    code, error, _ = work.run(0)
    if code != 0:
        raise RuntimeError(f"the sound {work.name} ended with {code}: {error}")
    return time.monotonic() - began


def _works(place: Path) -> list[_Work]:
    """A solve, a study of a flange, a diagnosis and a sweep."""
    from stiffopt.cli import run

    solves, studies, sets, sweeps = [], [], [], []
    for k in range(2):
        problem = place / f"p{k}.toml"
        robot = ROOT / "problems" / "two_link_robot.toml"
        problem.write_text(_PROBLEM.format(title=f"number {k}", robot=robot, end=0.5 + k / 4))
        solves.append(("solve", str(problem)))
        sweep = place / f"s{k}.toml"
        sweep.write_text(_SWEEP.format(title=f"number {k}", base=problem.name))
        sweeps.append(("sweep", str(sweep), "--workers", "2"))
        flange = place / f"flange{k}"
        with contextlib.redirect_stdout(io.StringIO()):
            run(["init", "flange", "--out", str(flange), "--torque", f"{100 + 20 * k} N*m"])
        studies.append(("preload", str(flange / "flange.toml")))
        folder = place / f"set{k}"
        shutil.copytree(RECORDED, folder)
        text = (folder / "recordings.toml").read_text()
        (folder / "recordings.toml").write_text(text.replace("1.7]", f"1.{7 + k}]"))
        sets.append(("diagnose", str(folder), "--no-experiment"))
    turns = {"solve": solves, "preload": studies, "diagnose": sets, "sweep": sweeps}
    return [
        _Work(name, tuple(two), place / f"out_{name}", place / f"{name}.mark")
        for name, two in turns.items()
    ]
