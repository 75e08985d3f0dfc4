"""`stiffopt export`: results as files for controllers and other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from stiffopt.cli.base import Out, app
from stiffopt.errors import InputError, nearest
from stiffopt.files import atomic_write
from stiffopt.folders import output_folder


@app.command
def export(
    result: Path,
    *,
    to: Annotated[str, Parameter(help="ros2, urscript, csv or krl-rsi.")],
    rate: float | None = None,
    of: Literal["motor", "link"] = "motor",
    out: Out | None = None,
) -> int:
    """Write a solved motion as a controller or another tool reads it.

    Parameters
    ----------
    result
        Folder of a solve whose motion keeps its limits.
    rate
        Samples a second [Hz]; default 500, for krl-rsi 250.
    of
        What the motors are commanded (command.csv where there is one), or what the links shall do.
    out
        Default: the folder of the solve.
    """
    from stiffopt.export.format import FORMATS
    from stiffopt.export.motion import read_motion

    if to not in FORMATS:
        raise InputError(f"--to {to}: unknown format. {nearest(to, list(FORMATS))}")
    texts = FORMATS[to].export(read_motion(result, of), rate)
    folder = out or result
    with output_folder(folder, f"export --to {to}", of="solve") as stage:
        for name, text in texts.items():
            atomic_write(stage / name, text)
    print(f"Wrote {', '.join(str(folder / name) for name in texts)}")
    return 0
