"""Standard output and error that accept any character and survive a closed pipe."""

from __future__ import annotations

import io
import os
import sys


class LenientStream(io.TextIOWrapper):
    """Text stream that discards output after the first failed write."""

    failure: OSError | None = None  # of the first write that failed

    def write(self, text: str, /) -> int:
        """Write text, or discard it."""
        try:
            return super().write(text)
        except OSError as error:
            self._discard_output(error)
            return len(text)

    def flush(self) -> None:
        """Flush the buffer, or discard it."""
        try:
            super().flush()
        except OSError as error:
            self._discard_output(error)

    def _discard_output(self, error: OSError) -> None:
        self.failure = self.failure or error
        # Buffered text and the flush of the interpreter at exit go to the null device.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)


def open_streams() -> None:
    """Replace stdout and stderr by streams whose failures do not end the program.

    Characters that the terminal's encoding lacks, and file names that are not UTF-8, are escaped;
    output to a closed stream is discarded.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif type(stream) is io.TextIOWrapper:
            encoding, buffered = stream.encoding, stream.line_buffering
            own = LenientStream(
                stream.detach(), encoding, "backslashreplace", line_buffering=buffered
            )
            setattr(sys, name, own)


def output_failure() -> OSError | None:
    """Return the error of standard output; None also for a pipe that its reader closed."""
    sys.stdout.flush()
    failure = getattr(sys.stdout, "failure", None)
    return None if isinstance(failure, BrokenPipeError) else failure
