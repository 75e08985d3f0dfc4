"""Spoiled files given to their loaders or commands, each in a process of its own with limits."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import pkgutil
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from benchmarks.reliability.commands import BYTES, SECONDS
from benchmarks.reliability.grammar import SPECIAL, by_grammar, special_file
from benchmarks.reliability.subject import Subject
from benchmarks.reliability.subjects import subjects

# Of a mutant by grammar; processor time, for machines are shared.
PROCESSOR_SECONDS = 10


class OptimisationBegins(BaseException):
    """All that was asked for can be stated: an optimiser has been given the programme."""


class FoundFaultError(Exception):
    """What a command did that its exit code does not show.

    Parameters
    ----------
    verdict : "traceback", "warning" or "silent"
    text : str
    """

    def __init__(self, verdict: str, text: str) -> None:
        super().__init__(text)
        self.verdict = verdict


def judged(work: Callable[[], object]) -> tuple[str, str]:
    """How a call ends: "accepted", "told", or the kind of a fault and what is known of it."""
    from stiffopt.errors import StiffoptError

    try:
        work()
    except StiffoptError as error:
        return ("told", "") if str(error).strip() else ("silent", type(error).__name__)
    except OSError as error:  # the command line says these as well
        return "told", type(error).__name__
    except OptimisationBegins:
        return "accepted", "an optimisation begins"
    except FoundFaultError as fault:
        return fault.verdict, str(fault)
    except Exception as error:  # whatever else reaches a user is a fault
        frames = [f for f in traceback.extract_tb(error.__traceback__) if "stiffopt" in f.filename]
        place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
        return "traceback", f"{type(error).__name__} at {place}: {error}"[:300]
    return "accepted", ""


def count(
    place: Path,
    number: int,
    *,
    commands: bool,
    grammar: bool = False,
    first: int = 0,
    record: Path | None = None,
    seconds: float = float("inf"),
) -> Counter[str]:
    """Verdicts on so many mutants, the kinds in turn; faults are printed as they come.

    With a `record` each is a line there, and what it has already is not done again; after
    `seconds` no more are begun.
    """
    every = [s for s in (by_grammar if grammar else subjects)(place) if s.command or not commands]
    if commands:
        _import_all()
    done = set() if record is None else {tuple(line.split("\t")[:2]) for line in _lines(record)}
    found: Counter[str] = Counter()
    began, worst = time.monotonic(), 0.0
    for k in range(number):
        subject, seed = every[k % len(every)], first + k // len(every)
        if (subject.kind, str(seed)) in done:
            continue
        since = time.monotonic()
        if since - began > seconds:
            break
        verdict, what = _mutant(subject, seed, commands, grammar)
        took = time.monotonic() - since
        worst = max(worst, took)
        found[verdict] += 1
        found[f"{subject.kind}: {verdict}"] += 1
        if record is not None:
            line = (subject.kind, str(seed), verdict, f"{took:.2f}", " ".join(what.split()))
            with record.open("a") as stream:
                stream.write("\t".join(line) + "\n")
        if verdict not in ("accepted", "told"):
            print(f"{verdict}  {subject.kind} {seed}: {what}", flush=True)
    print(f"{sum(n for name, n in found.items() if ':' not in name)} in "
          f"{time.monotonic() - began:.0f} s, the longest {worst:.1f} s")  # fmt: skip
    return found


def recorded(record: Path) -> Counter[str]:
    """Verdicts of a record, all and by kind."""
    found: Counter[str] = Counter()
    for line in _lines(record):
        kind, _, verdict, *_ = line.split("\t")
        found[verdict] += 1
        found[f"{kind}: {verdict}"] += 1
    return found


def alone(
    work: Callable[[], object], folder: Path, processor: int | None = None
) -> tuple[str, str]:
    """As `judged`, in `folder` and a child of this process with limits; crashes and hangs too.

    More than `processor` seconds of processor time are a hang as well.
    """
    inward, outward = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(inward)
        _limited(processor)
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
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL):
        return "hang", f"more than {processor} s of processor time"
    if os.WIFSIGNALED(status):
        return "crash", signal.Signals(os.WTERMSIG(status)).name
    return (verdict, what) if verdict else ("crash", f"exit {os.waitstatus_to_exitcode(status)}")


def called(command: Sequence[str], *, whole: bool = True) -> object:
    """Run a command line; its exit code 2 or 3 is a `StiffoptError` again.

    What stands on stderr is looked at too: a text of a traceback, a warning of a library, or exit
    code 2 without a word are faults. Not `whole`: as soon as an optimisation begins it is the end.
    """
    from stiffopt.cli import run
    from stiffopt.errors import StiffoptError

    with _stderr() as said, contextlib.nullcontext() if whole else _until_optimised():
        code = run(command)
    text = said.getvalue()
    for word, verdict in (("Traceback (most recent", "traceback"), ("Warning:", "warning")):
        if word in text:
            raise FoundFaultError(verdict, text[max(text.index(word) - 100, 0) :][:300])
    if code in (2, 3):
        if "stiffopt: " not in text and code == 2:
            raise FoundFaultError("silent", f"exit code {code} without a word")
        raise StiffoptError(f"exit code {code}")
    return code


@contextlib.contextmanager
def _stderr() -> Iterator[io.StringIO]:
    """All that is written to stderr, by libraries in C as well."""
    said = io.StringIO()
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as stream:
        os.dup2(stream.fileno(), 2)
        try:
            with contextlib.redirect_stderr(said):
                yield said
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            stream.seek(0)
            said.write(stream.read(10**6).decode(errors="replace"))


@contextlib.contextmanager
def _until_optimised() -> Iterator[None]:
    from stiffopt.solver import ipopt

    def begins(*_: object, **__: object) -> None:
        raise OptimisationBegins

    kept = ipopt.ca.nlpsol
    ipopt.ca.nlpsol = begins
    try:
        yield
    finally:
        ipopt.ca.nlpsol = kept


def _mutant(subject: Subject, seed: int, commands: bool, grammar: bool) -> tuple[str, str]:
    """Verdict on one mutant."""
    path = subject.folder / subject.file
    sound = path.read_bytes()
    choice = random.Random(f"special {subject.kind} {seed}")
    if grammar and choice.random() < SPECIAL:
        path.unlink()
        special_file(path, choice)
    else:
        path.write_bytes(subject.spoiled(sound, seed))
    processor = PROCESSOR_SECONDS if grammar else None
    try:
        if commands:
            call = lambda: called(subject.command, whole=subject.whole)  # noqa: E731
            return alone(call, subject.folder, processor)
        return alone(lambda: subject.read(path), subject.folder, processor)
    finally:
        _remove(path)
        path.write_bytes(sound)
        for out in (subject.folder / "out", subject.folder.parent / "out"):
            shutil.rmtree(out, ignore_errors=True)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _lines(record: Path) -> list[str]:
    return record.read_text().splitlines() if record.is_file() else []


def _import_all() -> None:
    """What commands import, once for all children."""
    import stiffopt

    for module in pkgutil.walk_packages(stiffopt.__path__, "stiffopt."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)


def _limited(processor: int | None) -> None:
    """Memory beyond what the process has, seconds of processor time, and silence."""
    from stiffopt.recording.readers.checks import data_segment_size

    most = data_segment_size() + BYTES
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if processor is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (processor, processor))
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
