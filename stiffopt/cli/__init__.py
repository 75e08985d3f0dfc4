"""The command line: `stiffopt solve`, `preload`, `diagnose`, `recording check` and the others.

Exit codes: 0 success, 1 a verified value deviates, 2 invalid input or command line, 3 no usable
result, 130 interrupted. Commands import their modules when called, so that help is fast.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence

from cyclopts import CycloptsError, UnusedCliTokensError

from stiffopt import folders
from stiffopt.cli import (
    budgets,
    elastic,
    exports,
    improvements,
    motions,
    recordings,
    schemas,
    starters,
    sweeps,
)
from stiffopt.cli.base import app
from stiffopt.errors import InputError, NoSolutionFound, shortened

__all__ = [
    "app",
    "budgets",
    "elastic",
    "exports",
    "improvements",
    "motions",
    "recordings",
    "run",
    "schemas",
    "starters",
    "sweeps",
]


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code; user errors become one message."""
    folders.written.clear()
    warnings.formatwarning = lambda message, *_, **__: f"stiffopt: {message}\n"
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except UnusedCliTokensError as error:
        print(f"stiffopt: {_describe_unused_tokens(error)}", file=sys.stderr)
        return 2
    except (InputError, CycloptsError) as error:
        print(f"stiffopt: {error}", file=sys.stderr)
        return 2
    except NoSolutionFound as error:
        print(f"stiffopt: {error}", file=sys.stderr)
        return 3
    except KeyboardInterrupt as stop:
        kept = " and ".join(map(str, folders.written))
        state = f"{kept} was written before." if kept else "nothing was written."
        state = next((each for each in stop.args if isinstance(each, str)), state)
        print(f"stiffopt: interrupted; {state}", file=sys.stderr)
        return 130
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"stiffopt: {place}{error.strerror or error}", file=sys.stderr)
        return 2
    return code if isinstance(code, int) else 0


def _describe_unused_tokens(error: UnusedCliTokensError) -> str:
    """Return a message on arguments that a command does not accept."""
    command, unused = " ".join(error.command_chain or ()), error.unused_tokens or []
    known = error.app.assemble_argument_collection() if error.app else ()
    options = {name for argument in known for name in argument.names}
    meant = [f" Did you mean --{token}?" for token in unused if f"--{token}" in options]
    extra = shortened(" ".join(unused))
    more = f"See `stiffopt {command} --help`."
    return f"{command}: unexpected argument {extra}.{''.join(meant)} {more}"
