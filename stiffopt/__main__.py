"""`python -m stiffopt`, and the `stiffopt` command."""

import sys
from contextlib import nullcontext

from stiffopt.interrupts import beginning


def main() -> None:
    """Run the command line; Ctrl-C while it is still loading is an interruption as well.

    Of a solve it waits for a motion from the first moment on.
    """
    try:
        with beginning() if sys.argv[1:2] == ["solve"] else nullcontext():
            from stiffopt.cli import run

            code = run()
    except KeyboardInterrupt:
        print("stiffopt: interrupted; nothing was written.", file=sys.stderr)
        code = 130
    sys.exit(code)


if __name__ == "__main__":
    main()
