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
    problem: Path | None = None,
    recordings: Path | None = None,
    effects: Path | None = None,
    out: Out | None = None,
    changes: NoChanges = (),
) -> int:
    """Write a solved motion, or a robot with what was found, as others read it.

    A motion is judged again before it leaves: hashes, duration, rows, and its limits at the samples
    that are written. `stiffopt check FILE` reads such a file back.

    Parameters
    ----------
    result
        Folder of a solve whose motion keeps its limits, or of a diagnosis.
    rate
        Samples a second [Hz]; default 500, for krl-rsi 250.
    of
        What the motors are commanded (command.csv where there is one), or what the links shall do.
    problem
        Problem file of a solve, where the result does not name it or it has moved.
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
        texts, maker = _extended_robot_files(result, to, recordings, effects), "diagnose"
    elif to in FORMATS:
        texts, maker = FORMATS[to].export(read_motion(result, of, problem), rate), "solve"
    else:
        names = [*FORMATS, *MODEL_FORMATS]
        raise InputError(f"--to {to}: unknown format. {nearest(to, names)}")
    folder = out or result
    with output_folder(folder, f"export --to {to}", of=maker) as stage:
        for name, text in texts.items():
            atomic_write(stage / name, text)
    print(f"Wrote {', '.join(str(folder / name) for name in texts)}")
    return 0


@app.command
def check(
    file: Path,
    *,
    result: Path | None = None,
    problem: Path | None = None,
    changes: NoChanges = (),
) -> int:
    """Say whether an exported motion is whole, whose it is, and whether it keeps its limits.

    The file's header names motion, robot, payload and limits by their hashes. They are held against
    the result, whose motion is judged and sampled anew; every number of the file must be that of
    the result.

    Parameters
    ----------
    file
        Of `stiffopt export`: ros2, urscript, csv or krl-rsi.
    result
        Folder of the solve that it is of; default: the folder of the file.
    problem
        Problem file, where the result does not name it or it has moved.
    """
    from stiffopt.export.check import check_file

    refuse_changes(changes)
    found = check_file(file, result or file.parent, problem)
    print(f"{file}: whole and unchanged since `stiffopt export --to {found.format}`.")
    print(
        f"Motion of the {found.which}s of {found.title}, robot {found.robot}"
        f"{'' if found.payload is None else f' with {found.payload:.4g} kg of payload'}, "
        f"{found.duration:.6g} s, {found.samples} samples at {found.rate:g} Hz."
    )
    print(f"Keeps its limits; the tightest is {found.tightest}.")
    return 0


def _extended_robot_files(
    result: Path, to: str, recordings: Path, effects: Path | None
) -> dict[str, str]:
    """Text of a robot with what a diagnosis found; the changes are printed."""
    from stiffopt.export.found import read_found
    from stiffopt.export.model_format import MODEL_FORMATS, notes

    found = read_found(result, recordings, effects)
    for line in (*notes(found), *MODEL_FORMATS[to].remarks(found)):
        print(line)
    return {MODEL_FORMATS[to].file: MODEL_FORMATS[to].text(found)}
