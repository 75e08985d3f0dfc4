"""`python -m stiffopt`, and the `stiffopt` command."""

import gc
import io
import os
import sys
from contextlib import nullcontext

from stiffopt.interrupts import beginning

# Of the search for unreachable cycles, of which a command leaves few: at every 700th object, as
# Python has it, it was a tenth of a solve.
_SELDOM = (50_000, 20, 100)


def main() -> None:
    """Run the command line; Ctrl-C while it is still loading is an interruption as well.

    Of a solve it waits for a motion from the first moment on.
    """
    gc.set_threshold(*_SELDOM)
    _keep_streams()
    try:
        with beginning() if sys.argv[1:2] == ["solve"] else nullcontext():
            if sys.argv[1:2] == ["sweep"]:
                from stiffopt.sweep.processes import load_ahead

                load_ahead(sys.argv[2:])
            from stiffopt.cli import run

            code = run()
    except KeyboardInterrupt:
        print("stiffopt: interrupted; nothing was written.", file=sys.stderr)
        code = 130
    # What is left goes with the process: nothing of it is looked through once more.
    gc.freeze()
    sys.exit(code)


def _keep_streams() -> None:
    """Make stdout and stderr take any text: of an answer, no character may lose the rest.

    What a terminal's encoding lacks is escaped, as are names of files that are not UTF-8; where a
    stream is closed, what is said there is lost, and nothing else.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


if __name__ == "__main__":
    main()
