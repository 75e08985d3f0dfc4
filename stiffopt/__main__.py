"""`python -m stiffopt`, and the `stiffopt` command."""

import sys


def main() -> None:
    """Run the command line; Ctrl-C while it is still loading is an interruption as well."""
    try:
        from stiffopt.cli import run

        code = run()
    except KeyboardInterrupt:
        print("stiffopt: interrupted; nothing was written.", file=sys.stderr)
        code = 130
    sys.exit(code)


if __name__ == "__main__":
    main()
