"""`stiffopt export`: results as files for controllers and other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from stiffopt.cli.base import NoChanges, Out, app, refuse_changes
from stiffopt.errors import InputError, nearest
from stiffopt.files import atomic_write
from stiffopt.folders import output_folder


@app.command
def export(
    result: Path,
    *,
    to: Annotated[
        str, Parameter(help="Of a solve: ros2, urscript, csv, krl-rsi. Of a diagnosis: urdf, mjcf.")
    ],
    rate: float | None = None,
    of: Literal["motor", "link"] = "motor",
    recordings: Path | None = None,
    effects: Path | None = None,
    out: Out | None = None,
    changes: NoChanges = (),
) -> int:
    """Write a solved motion, or a robot with what was found, as others read it.

    Parameters
    ----------
    result
        Folder of a solve whose motion keeps its limits, or of a diagnosis.
    rate
        Samples a second [Hz]; default 500, for krl-rsi 250.
    of
        What the motors are commanded (command.csv where there is one), or what the links shall do.
    recordings
        Recording set of a diagnosis: its robot is changed by what was found.
    effects
        Python file of the effects of a diagnosis that are not of the catalogue.
    out
        Default: the folder of the result.
    """
    from stiffopt.export.format import FORMATS
    from stiffopt.export.model_format import MODEL_FORMATS
    from stiffopt.export.motion import read_motion
    from stiffopt.result.store import RESULT_FILE

    refuse_changes(changes)
    if to in MODEL_FORMATS:
        if recordings is None:
            if (result / RESULT_FILE).exists():
                raise InputError(
                    f"--to {to} is of a diagnosis; {result} holds a solve, which goes to"
                    f" {', '.join(FORMATS)}."
                )
            raise InputError(
                f"--to {to}: give the recording set of the diagnosis as --recordings, whose robot "
                "is changed by what was found."
            )
        texts, maker = _found(result, to, recordings, effects), "diagnose"
    elif to in FORMATS:
        texts, maker = FORMATS[to].export(read_motion(result, of), rate), "solve"
    else:
        names = [*FORMATS, *MODEL_FORMATS]
        raise InputError(f"--to {to}: unknown format. {nearest(to, names)}")
    folder = out or result
    with output_folder(folder, f"export --to {to}", of=maker) as stage:
        for name, text in texts.items():
            atomic_write(stage / name, text)
    print(f"Wrote {', '.join(str(folder / name) for name in texts)}")
    return 0


def _found(result: Path, to: str, recordings: Path, effects: Path | None) -> dict[str, str]:
    """Text of a robot with what a diagnosis found; the changes are printed."""
    from stiffopt.export.found import read_found
    from stiffopt.export.model_format import MODEL_FORMATS, notes

    found = read_found(result, recordings, effects)
    for line in (*notes(found), *MODEL_FORMATS[to].remarks(found)):
        print(line)
    return {MODEL_FORMATS[to].file: MODEL_FORMATS[to].text(found)}
