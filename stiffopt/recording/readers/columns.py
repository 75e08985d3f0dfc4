"""Checks that every reader shares."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from stiffopt.errors import InputFileError, nearest
from stiffopt.recording.signals import Signals


def require_time(signals: Signals, path: Path) -> None:
    """Raise `InputFileError` if the set names no time column for a file without own stamps."""
    if not signals.time:
        raise InputFileError(
            path, "", "signals.time is required for this format: the column of the time [s]."
        )


def missing(path: Path, wanted: Sequence[str], there: Iterable[str]) -> None:
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
