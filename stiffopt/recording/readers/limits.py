"""What a run may hold at most: sizes that a file declares are compared before they are believed."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stiffopt.errors import InputFileError

# Numbers in one run, 8 bytes each; an hour of six joints with three signals at 500 Hz has 34e6.
MOST_NUMBERS = 40_000_000
# Bytes of messages, unpacked: a bag may hold other topics beside the wanted ones.
MOST_BYTES = 2**30
# Messages on the named topics, which can be decoded in a few minutes.
MOST_MESSAGES = 2_000_000
# Beyond what the process holds already, where a format's library believes more than it should.
MOST_MEMORY = 3 * 2**29

# An hour of messages takes a minute or two.
MOST_SECONDS = 600.0


class OutOfTime(Exception):
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
        raise OutOfTime

    before = signal.signal(signal.SIGALRM, stop)
    left, _ = signal.setitimer(signal.ITIMER_REAL, MOST_SECONDS)
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
    most = held_data() + MOST_MEMORY
    given = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min([most, *given]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def held_data() -> int:
    """Bytes of this process that Linux counts against RLIMIT_DATA: without the stack."""
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    (line,) = (line for line in status.splitlines() if line.startswith("VmData:"))
    return 1024 * int(line.split()[1])


def check_numbers(path: Path, samples: int, columns: int) -> None:
    """Raise `InputFileError` if so many samples of so many columns are no plausible run."""
    if samples * columns > MOST_NUMBERS:
        raise InputFileError(
            path,
            "",
            f"declares {samples} samples of {columns} columns, and a run may hold at most "
            f"{MOST_NUMBERS:.0e} numbers. Split it, or record at a lower rate.",
        )


def check_bytes(path: Path, size: int, what: str = "") -> None:
    """Raise `InputFileError` if so many bytes, unpacked, are no plausible run."""
    if size > MOST_BYTES:
        raise InputFileError(
            path,
            what,
            f"declares {size / 2**30:.3g} GiB, unpacked, and at most {MOST_BYTES / 2**30:.0f} GiB "
            "is read. Split it, or keep only the topics that are named.",
        )


def check_messages(path: Path, count: int) -> None:
    """Raise `InputFileError` if so many messages are no plausible run."""
    if count > MOST_MESSAGES:
        raise InputFileError(
            path,
            "",
            f"has more than {MOST_MESSAGES} messages on the topics that [signals] names. Split "
            "it, or record at a lower rate.",
        )
