"""Entry point of `python -m stiffopt` and of the `stiffopt` command."""

import gc
import sys
from contextlib import nullcontext

from stiffopt.interrupts import defer_until_result
from stiffopt.streams import open_streams, output_failure

# Thresholds of the cyclic garbage collector: with Python's default of 700 objects it takes a tenth
# of a solve.
_GC_THRESHOLDS = (50_000, 20, 100)


def main() -> None:
    """Run the command line; Ctrl-C during loading is an interruption as well.

    In a solve, Ctrl-C waits for a motion from the start.
    """
    gc.set_threshold(*_GC_THRESHOLDS)
    open_streams()
    try:
        with defer_until_result() if sys.argv[1:2] == ["solve"] else nullcontext():
            if sys.argv[1:2] == ["sweep"]:
                from stiffopt.sweep.processes import load_ahead

                load_ahead(sys.argv[2:])
            from stiffopt.cli import run

            code = run()
    except KeyboardInterrupt:
        print("stiffopt: interrupted; nothing was written.", file=sys.stderr)
        code = 130
    failure = output_failure()
    if failure is not None:
        from stiffopt import folders

        kept = f" {folders.written[-1]} was written nevertheless." if folders.written else ""
        print(f"stiffopt: stdout: {failure.strerror}.{kept}", file=sys.stderr)
        code = code if kept else 2
    # Skip the final garbage collection: the process ends.
    gc.freeze()
    sys.exit(code)


if __name__ == "__main__":
    main()
