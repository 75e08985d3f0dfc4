"""The application that commands register with, and what they share."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter, Token

from stiffopt.errors import InputError, shortened

# `stiffopt --install-completion` installs the completion of the shell that it runs in.
app = App(
    name="stiffopt",
    help="Stiff and true trajectories for industrial robot arms.",
    help_on_error=False,
    # `run` says what an interruption means.
    suppress_keyboard_interrupt=False,
)

app.register_install_completion_command(add_to_startup=False)

OUT_NAMES = ("--out", "-o")


def out_path(_: object, tokens: Sequence[Token]) -> Path:
    """Path of --out; an empty one would be the current folder."""
    name = tokens[0].value
    if not name.strip():
        raise InputError("got no name. Give one, or . for the current folder.")
    return Path(name)


Out = Annotated[
    Path,
    Parameter(name=OUT_NAMES, help="Folder for the results; made if missing.", converter=out_path),
]

Changes = Annotated[
    tuple[str, ...],
    Parameter(
        name="--set",
        negative=(),
        help="Change an entry of the file for this run, such as motion.duration='0.5 s'.",
    ),
]
Open = Annotated[
    bool, Parameter(name="--open", negative=(), help="Show the page in the browser when done.")
]


# Of the name of a folder.
_MAX_CHANGES_LENGTH = 100


def default_folder(name: str, changes: Sequence[str]) -> Path:
    """Where results go without --out; those of --set beside those of the file as it is."""
    bare = (re.sub(r"[\"']", "", change) for change in changes)
    said = "".join("-" + re.sub(r"[^\w.=+-]+", "_", each, flags=re.ASCII) for each in bare)
    if len(said) > _MAX_CHANGES_LENGTH:
        said = (
            f"{said[:_MAX_CHANGES_LENGTH]}-{hashlib.sha256(repr(changes).encode()).hexdigest()[:8]}"
        )
    return Path("out") / f"{name}{said}"


def show_report(folder: Path, wanted: bool, name: str = "report.html") -> None:
    """Open a page of a folder in the browser, where it is wanted."""
    if wanted and (folder / name).is_file():
        import webbrowser

        webbrowser.open((folder / name).resolve().as_uri())


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


# Of commands that take a folder of results or write a first file: understood, and refused with a
# reason.
NoChanges = Annotated[tuple[str, ...], Parameter(name="--set", negative=(), show=False)]
_RESULT_FOLDER_REASON = (
    "a folder of results is what was solved, and has no entries to change. Solve, study or"
    " diagnose again with --set."
)
STARTER_FILE_REASON = (
    "the file that this writes is yours to edit, and the command that reads it takes --set."
)


def refuse_changes(changes: tuple[str, ...], why: str = _RESULT_FOLDER_REASON) -> None:
    """Raise `InputError` where entries were to be changed of what has none."""
    if changes:
        raise InputError(f"--set {shortened(changes[0])}: {why}")
