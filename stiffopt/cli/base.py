"""The application that commands register with, and their common parameters and helpers."""

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
    # `run` reports interruptions.
    suppress_keyboard_interrupt=False,
)

app.register_install_completion_command(add_to_startup=False)

OUT_NAMES = ("--out", "-o")


def out_path(_: object, tokens: Sequence[Token]) -> Path:
    """Convert --out to a path; refuse an empty one, which would be the current folder."""
    name = tokens[0].value
    if not name.strip():
        raise InputError("got no name. Give one, or . for the current folder.")
    return Path(name)


Out = Annotated[Path, Parameter(name=OUT_NAMES, converter=out_path)]

Changes = Annotated[
    tuple[str, ...],
    Parameter(
        name="--set",
        negative=(),
        show_default=False,
        help="Override an entry of the file for this run, such as motion.duration='0.5 s'.",
    ),
]
Quiet = Annotated[bool, Parameter(help="No progress display.")]
SolvedProblem = Annotated[
    Path | None,
    Parameter(help="Problem file, where the result does not name it or it was moved."),
]
Open = Annotated[
    bool,
    Parameter(
        name="--open",
        negative=(),
        show_default=False,
        help="Open the report in the browser when done.",
    ),
]


# Characters of a folder name from --set; longer ones are replaced by a hash.
_MAX_CHANGES_LENGTH = 100


def default_folder(name: str, changes: Sequence[str]) -> Path:
    """Return the folder for results without --out; --set has its own, beside that of the file."""
    bare = (re.sub(r"[\"']", "", change) for change in changes)
    suffix = "".join("-" + re.sub(r"[^\w.=+-]+", "_", each, flags=re.ASCII) for each in bare)
    if len(suffix) > _MAX_CHANGES_LENGTH:
        digest = hashlib.sha256(repr(changes).encode()).hexdigest()[:8]
        suffix = f"{suffix[:_MAX_CHANGES_LENGTH]}-{digest}"
    return Path("out") / f"{name}{suffix}"


def show_report(folder: Path, wanted: bool, name: str = "report.html") -> None:
    """Open a page of a folder in the browser if requested and present."""
    if wanted and (folder / name).is_file():
        import webbrowser

        webbrowser.open((folder / name).resolve().as_uri())


def print_json(document: object) -> None:
    """Print plain data as indented JSON."""
    import json

    print(json.dumps(document, indent=2, ensure_ascii=False))


def number_or_text(argument: str) -> float | str:
    """Convert an argument as in files: a bare number is SI, a text has its unit."""
    try:
        return float(argument)
    except ValueError:
        return argument.strip()


# --set of commands that cannot apply it: accepted by the parser, refused with a reason.
NoChanges = Annotated[tuple[str, ...], Parameter(name="--set", negative=(), show=False)]
_RESULT_FOLDER_REASON = (
    "a folder of results has no entries to change. Run solve, preload or diagnose again with --set."
)
STARTER_FILE_REASON = "edit the file that is written, or use --set with the command that reads it."


def refuse_changes(changes: tuple[str, ...], why: str = _RESULT_FOLDER_REASON) -> None:
    """Raise `InputError` where --set is given but not supported."""
    if changes:
        raise InputError(f"--set {shortened(changes[0])}: {why}")
