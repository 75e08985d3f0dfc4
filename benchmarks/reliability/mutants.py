"""Spoiled files given to their loaders or commands, each in a process of its own with limits."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.reliability.commands import BYTES, SECONDS
from benchmarks.reliability.subjects import Subject, subjects


def judged(work: Callable[[], object]) -> tuple[str, str]:
    """How a call ends: "accepted", "told", or the kind of a fault and what is known of it."""
    from stiffopt.errors import StiffoptError

    try:
        work()
    except StiffoptError as error:
        return ("told", "") if str(error).strip() else ("silent", type(error).__name__)
    except OSError as error:  # the command line says these as well
        return "told", type(error).__name__
    except Exception as error:  # whatever else reaches a user is a fault
        frames = [f for f in traceback.extract_tb(error.__traceback__) if "stiffopt" in f.filename]
        place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
        return "traceback", f"{type(error).__name__} at {place}: {error}"[:300]
    return "accepted", ""


def count(place: Path, number: int, *, commands: bool, first: int = 0) -> Counter[str]:
    """Verdicts on so many mutants, the kinds in turn; faults are printed as they come."""
    every = [s for s in subjects(place) if s.command or not commands]
    found: Counter[str] = Counter()
    began, worst = time.monotonic(), 0.0
    for k in range(number):
        subject, seed = every[k % len(every)], first + k // len(every)
        since = time.monotonic()
        verdict, what = _mutant(subject, seed, commands)
        worst = max(worst, time.monotonic() - since)
        found[verdict] += 1
        found[f"{subject.kind}: {verdict}"] += 1
        if verdict not in ("accepted", "told"):
            print(f"{verdict}  {subject.kind} {seed}: {what}", flush=True)
        if (k + 1) % 200 == 0:
            kinds = {name: n for name, n in found.items() if ":" not in name}
            print(f"{k + 1}: {kinds}, the longest {worst:.1f} s", flush=True)
    print(f"{number} in {time.monotonic() - began:.0f} s, the longest {worst:.1f} s")
    return found


def alone(work: Callable[[], object], folder: Path) -> tuple[str, str]:
    """As `judged`, in `folder` and a child of this process with limits; crashes and hangs too."""
    inward, outward = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(inward)
        _limited()
        os.chdir(folder)
        verdict, what = judged(work)
        os.write(outward, f"{verdict}\n{what}".encode(errors="replace"))
        os._exit(0)
    os.close(outward)
    status = _waited(child)
    with os.fdopen(inward) as stream:
        verdict, _, what = stream.read().partition("\n")
    if status is None:
        return "hang", f"no end in {SECONDS:g} s"
    if os.WIFSIGNALED(status):
        return "crash", signal.Signals(os.WTERMSIG(status)).name
    return (verdict, what) if verdict else ("crash", f"exit {os.waitstatus_to_exitcode(status)}")


def called(command: Sequence[str]) -> object:
    """Run a command line; its exit code 2 or 3 is a `StiffoptError` again."""
    from stiffopt.cli import run
    from stiffopt.errors import StiffoptError

    code = run(command)
    if code in (2, 3):
        raise StiffoptError(f"exit code {code}")
    return code


def _mutant(subject: Subject, seed: int, commands: bool) -> tuple[str, str]:
    """Verdict on one mutant."""
    path = subject.folder / subject.file
    sound = path.read_bytes()
    path.write_bytes(subject.spoiled(sound, seed))
    try:
        if commands:
            return alone(lambda: called(subject.command), subject.folder)
        return alone(lambda: subject.read(path), subject.folder)
    finally:
        path.write_bytes(sound)
        for out in (subject.folder / "out", subject.folder.parent / "out"):
            shutil.rmtree(out, ignore_errors=True)


def _limited() -> None:
    """Memory beyond what the process has, and silence."""
    from stiffopt.recording.readers.limits import held_data

    most = held_data() + BYTES
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, sys.stdout.fileno())
    os.dup2(silent, sys.stderr.fileno())


def _waited(child: int) -> int | None:
    """Status of a child that ended in time; None of one that had to be killed."""
    end, pause = time.monotonic() + SECONDS, 1e-3
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status
        time.sleep(pause)
        pause = min(1.5 * pause, 0.1)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None
