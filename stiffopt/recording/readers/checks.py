"""Checks that every reader shares: declared sizes, time and memory, columns, episodes."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from stiffopt.errors import InputFileError, nearest
from stiffopt.recording.signals import Signals

# Numbers in one run, 8 bytes each; an hour of six joints with three signals at 500 Hz has 34e6.
MAX_NUMBERS = 40_000_000
# Bytes of messages, unpacked: a bag may hold other topics beside the wanted ones.
MAX_BYTES = 2**30
# Messages on the named topics, which can be decoded in a few minutes.
MAX_MESSAGES = 2_000_000
# Beyond what the process holds already, where a format's library believes more than it should.
MAX_MEMORY = 3 * 2**29

# An hour of messages takes a minute or two.
MAX_SECONDS = 600.0


class ReadTimeout(Exception):
    """A reader took longer than `MOST_SECONDS`."""


@contextmanager
def bounded_time() -> Iterator[None]:
    """Within, what takes longer than `MOST_SECONDS` meets `OutOfTime`, in a process's main thread.

    Elsewhere, and where the system has no timer, nothing is bounded.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or not hasattr(signal, "SIGALRM"):
        yield
        return

    def stop(*_: object) -> None:
        raise ReadTimeout

    before = signal.signal(signal.SIGALRM, stop)
    left, _ = signal.setitimer(signal.ITIMER_REAL, MAX_SECONDS)
    try:
        yield
    finally:
        # Someone else's timer goes on.
        signal.setitimer(signal.ITIMER_REAL, left)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def bounded_memory() -> Iterator[None]:
    """Within, what asks for more than `MOST_MEMORY` meets a MemoryError, where the system can."""
    if sys.platform != "linux":
        yield
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = data_segment_size() + MAX_MEMORY
    given = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min([most, *given]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def data_segment_size() -> int:
    """Bytes of this process that Linux counts against RLIMIT_DATA: without the stack."""
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    (line,) = (line for line in status.splitlines() if line.startswith("VmData:"))
    return 1024 * int(line.split()[1])


def check_numbers(path: Path, samples: int, columns: int) -> None:
    """Raise `InputFileError` if so many samples of so many columns are no plausible run."""
    if samples * columns > MAX_NUMBERS:
        raise InputFileError(
            path,
            "",
            f"declares {samples} samples of {columns} columns, and a run may hold at most "
            f"{MAX_NUMBERS:.0e} numbers. Split it, or record at a lower rate.",
        )


def check_bytes(path: Path, size: int, what: str = "") -> None:
    """Raise `InputFileError` if so many bytes, unpacked, are no plausible run."""
    if size > MAX_BYTES:
        raise InputFileError(
            path,
            what,
            f"declares {size / 2**30:.3g} GiB, unpacked, and at most {MAX_BYTES / 2**30:.0f} GiB "
            "is read. Split it, or keep only the topics that are named.",
        )


def check_messages(path: Path, count: int) -> None:
    """Raise `InputFileError` if so many messages are no plausible run."""
    if count > MAX_MESSAGES:
        raise InputFileError(
            path,
            "",
            f"has more than {MAX_MESSAGES} messages on the topics that [signals] names. Split "
            "it, or record at a lower rate.",
        )


def require_time(signals: Signals, path: Path) -> None:
    """Raise `InputFileError` if the set names no time column for a file without own stamps."""
    if not signals.time:
        raise InputFileError(
            path, "", "signals.time is required for this format: the column of the time [s]."
        )


def check_columns(path: Path, wanted: Sequence[str], there: Iterable[str]) -> None:
    """Raise `InputFileError` if a wanted column is not there."""
    names = list(there)
    lacking = [name for name in wanted if name not in names]
    if lacking:
        others = f" (nor {', '.join(lacking[1:])})" if len(lacking) > 1 else ""
        raise InputFileError(
            path,
            "",
            f"has no column {lacking[0]!r}{others}, which [signals] names. "
            f"{nearest(lacking[0], names)} Correct [signals] or the file.",
        )


def split_episode(path: Path) -> tuple[Path, int | None]:
    """File and number of the episode of "FILE.parquet#3"."""
    name, mark, number = path.name.rpartition("#")
    if not mark or path.exists():
        return path, None
    if not number.isdecimal():
        raise InputFileError(path, "", f"{number!r} is no episode; give its number, as in #0.")
    return path.parent / name, int(number)


def find_dataset_info(path: Path) -> Path | None:
    """meta/info.json of the dataset that a Parquet file belongs to; None where it has none."""
    for folder in list(path.resolve().parents)[:4]:
        found = folder / "meta" / "info.json"
        if found.is_file():
            return found
    return None
