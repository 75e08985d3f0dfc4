"""The application that commands register with, and what they share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

app = App(
    name="stiffopt",
    help="Stiff and true trajectories for industrial robot arms.",
    help_on_error=False,
    # `run` says what an interruption means.
    suppress_keyboard_interrupt=False,
)

Out = Annotated[Path, Parameter(name="--out", help="Folder for the results; made if missing.")]


def print_json(document: object) -> None:
    """Print plain data, indented."""
    import json

    print(json.dumps(document, indent=2, ensure_ascii=False))


def number_or_text(argument: str) -> float | str:
    """Argument as files have it: a bare number is SI, a text carries its unit."""
    try:
        return float(argument)
    except ValueError:
        return argument.strip()
