"""Standard output and error that take any text: no character or closed pipe loses an answer."""

from __future__ import annotations

import io
import os
import sys


class LenientStream(io.TextIOWrapper):
    """Text stream of a program that goes on where nothing can be written any more.

    Attributes
    ----------
    failure : OSError or None
        Of the first write that failed; what follows is dropped.
    """

    failure: OSError | None = None

    def write(self, text: str, /) -> int:
        """Write text, or drop it."""
        try:
            return super().write(text)
        except OSError as error:
            self._discard_output(error)
            return len(text)

    def flush(self) -> None:
        """Hand on what was written, or drop it."""
        try:
            super().flush()
        except OSError as error:
            self._discard_output(error)

    def _discard_output(self, error: OSError) -> None:
        self.failure = self.failure or error
        # What is buffered goes there as well, and the interpreter's own flush at exit.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)


def open_streams() -> None:
    """Replace stdout and stderr by streams whose failures do not end the program.

    What a terminal's encoding lacks is escaped, as are names of files that are not UTF-8; what is
    said to a closed stream is dropped.
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
    """Reason why stdout could not be written; None also where its reader had read enough."""
    sys.stdout.flush()
    failure = getattr(sys.stdout, "failure", None)
    return None if isinstance(failure, BrokenPipeError) else failure
