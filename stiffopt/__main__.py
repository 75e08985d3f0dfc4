"""`python -m stiffopt`, and the `stiffopt` command."""

import gc
import sys
from contextlib import nullcontext

from stiffopt.interrupts import beginning

# Of the search for unreachable cycles, of which a command leaves few: at every 700th object, as
# Python has it, it was a tenth of a solve.
_GC_THRESHOLDS = (50_000, 20, 100)


def main() -> None:
    """Run the command line; Ctrl-C while it is still loading is an interruption as well.

    Of a solve it waits for a motion from the first moment on.
    """
    gc.set_threshold(*_GC_THRESHOLDS)
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


if __name__ == "__main__":
    main()
