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

# Numbers of one run, 8 bytes each; an hour of six joints with three signals at 500 Hz has 34e6.
MAX_NUMBERS = 40_000_000
# Uncompressed messages [bytes]: a bag may contain other topics beside the named ones.
MAX_BYTES = 2**30
# Messages on the named topics; so many are decoded in a few minutes.
MAX_MESSAGES = 2_000_000
# Memory beyond that of the process [bytes], where a library trusts a faulty file.
MAX_MEMORY = 3 * 2**29

# Time to read a run [s]; an hour of messages takes a minute or two.
MAX_SECONDS = 600.0


class ReadTimeout(Exception):
    """A reader took longer than `MAX_SECONDS`."""


@contextmanager
def bounded_time() -> Iterator[None]:
    """Raise `ReadTimeout` in code that takes longer than `MAX_SECONDS`.

    Only in the main thread of a process, and where the system has a timer.
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
        # Restore the timer of the caller.
        signal.setitimer(signal.ITIMER_REAL, left)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def bounded_memory() -> Iterator[None]:
    """Raise MemoryError in code that allocates more than `MAX_MEMORY`; on Linux only."""
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
    """Memory of this process that counts against RLIMIT_DATA on Linux [bytes]."""
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    (line,) = (line for line in status.splitlines() if line.startswith("VmData:"))
    return 1024 * int(line.split()[1])


def check_numbers(path: Path, samples: int, columns: int) -> None:
    """Raise `InputFileError` if samples times columns exceed `MAX_NUMBERS`."""
    if samples * columns > MAX_NUMBERS:
        raise InputFileError(
            path,
            "",
            f"declares {samples} samples of {columns} columns, and a run may hold at most "
            f"{MAX_NUMBERS:.0e} numbers. Split it, or record at a lower rate.",
        )


def check_bytes(path: Path, size: int) -> None:
    """Raise `InputFileError` if the uncompressed size exceeds `MAX_BYTES`."""
    if size > MAX_BYTES:
        raise InputFileError(
            path,
            "",
            f"declares {size / 2**30:.3g} GiB, unpacked, and at most {MAX_BYTES / 2**30:.0f} GiB "
            "is read. Split it, or keep only the topics that are named.",
        )


def check_messages(path: Path, count: int) -> None:
    """Raise `InputFileError` if the number of messages exceeds `MAX_MESSAGES`."""
    if count > MAX_MESSAGES:
        raise InputFileError(
            path,
            "",
            f"has more than {MAX_MESSAGES} messages on the topics that [signals] names. Split "
            "it, or record at a lower rate.",
        )


def require_time(signals: Signals, path: Path) -> None:
    """Raise `InputFileError` if the set names no time column and the format has no stamps."""
    if not signals.time:
        raise InputFileError(
            path, "", "signals.time is required for this format: the column of the time [s]."
        )


def check_columns(
    path: Path, wanted: Sequence[str], there: Iterable[str], by: str = "[signals]"
) -> None:
    """Raise `InputFileError` if a column that is named `by` a part of the set is missing."""
    names = list(there)
    lacking = [name for name in wanted if name not in names]
    if lacking:
        others = f" (nor {', '.join(lacking[1:])})" if len(lacking) > 1 else ""
        raise InputFileError(
            path,
            "",
            f"has no column {lacking[0]!r}{others}, which {by} names. "
            f"{nearest(lacking[0], names)} Correct {by} or the file.",
        )


def split_part(path: Path) -> tuple[Path, str | None]:
    """Split "FILE.parquet#3" into file and the name of one run in it, None without one."""
    name, mark, part = path.name.rpartition("#")
    if not mark or not name or path.exists():
        return path, None
    return path.parent / name, part


def find_dataset_info(path: Path) -> Path | None:
    """Find meta/info.json of the dataset of a Parquet file; None where it has none."""
    for folder in list(path.resolve().parents)[:4]:
        found = folder / "meta" / "info.json"
        if found.is_file():
            return found
    return None
