"""`python -m stiffopt`, and the `stiffopt` command."""

import gc
import sys
from contextlib import nullcontext

from stiffopt.interrupts import beginning

# Collection of reference cycles: Python's default, every 700 objects, took a tenth of a solve.
_GC_THRESHOLDS = (50_000, 20, 100)


def main() -> None:
    """Run the command line; Ctrl-C is handled from the first import on.

    In `solve` an interruption waits for a first motion.
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
    # The process ends: no further collection of its objects.
    gc.freeze()
    sys.exit(code)


if __name__ == "__main__":
    main()
