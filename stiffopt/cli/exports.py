"""`stiffopt export` and `check`: results as files for controllers and other tools."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from stiffopt.cli.base import NoChanges, Out, SolvedProblem, app, refuse_changes
from stiffopt.errors import InputError, nearest
from stiffopt.files import atomic_write
from stiffopt.folders import output_folder


@app.command
def export(
    result: Path,
    *,
    to: Annotated[
        str,
        Parameter(
            help="Format: ros2, csv, urscript, krl-rsi, abb-egm, fanuc-stream, yaskawa-job or "
            "staubli-val3 of a solve; urdf, mjcf or usd of a diagnosis."
        ),
    ],
    rate: float | None = None,
    pulses: str | None = None,
    of: Literal["motor", "link"] = "motor",
    problem: Path | None = None,
    recordings: Path | None = None,
    effects: Path | None = None,
    out: Out | None = None,
    changes: NoChanges = (),
) -> int:
    """Export a solved motion to a controller format, or the robot model of a diagnosis.

    A motion is verified before export: hashes, duration, samples, and its limits at the samples
    that are written. `stiffopt check FILE` verifies an exported file.

    Parameters
    ----------
    result
        Folder of a solve or an improvement whose motion meets its limits, or of a diagnosis.
    rate
        Sampling rate [Hz]; default 500, for krl-rsi 250, for yaskawa-job and staubli-val3 20.
    pulses
        Pulses per degree of axes S to T for yaskawa-job, such as 1341.4,1907.7,1593,1023,980,455.
    of
        Motion of the motors (command.csv where there is one) or of the links.
    problem
        Problem file of a solve, where the result does not name it or it was moved.
    recordings
        Recording set of a diagnosis, whose robot is changed by the findings.
    effects
        Python file of user-defined effects of a diagnosis.
    out
        Folder for the files; default: the folder of the result.
    """
    from stiffopt.export.folder_motions import read_stored
    from stiffopt.export.format import FORMATS
    from stiffopt.export.model_format import MODEL_FORMATS
    from stiffopt.improvement.improvement_files import IMPROVEMENT_FILE
    from stiffopt.result.store import RESULT_FILE

    refuse_changes(changes)
    if to in MODEL_FORMATS:
        if recordings is None:
            if (result / RESULT_FILE).exists():
                raise InputError(
                    f"--to {to} is a format of a diagnosis; {result} is the folder of a solve, with"
                    f" the formats {', '.join(FORMATS)}."
                )
            raise InputError(
                f"--to {to}: give the recording set of the diagnosis as --recordings; its robot is "
                "changed by the findings."
            )
        texts: Mapping[str, str | bytes]
        texts, maker = _extended_robot_files(result, to, recordings, effects), "diagnose"
    elif to in FORMATS:
        form = FORMATS[to] if pulses is None else FORMATS[to].with_pulses(_read_numbers(pulses))
        texts, maker = form.export(read_stored(result, of, problem), rate), "solve"
        maker = "improve" if (result / IMPROVEMENT_FILE).is_file() else maker
    else:
        names = [*FORMATS, *MODEL_FORMATS]
        raise InputError(f"--to {to}: unknown format. {nearest(to, names)}")
    folder = out or result
    with output_folder(folder, f"export --to {to}", of=maker) as stage:
        for name, text in texts.items():
            (stage / name).parent.mkdir(parents=True, exist_ok=True)
            atomic_write(stage / name, text)
    print(f"Wrote {', '.join(str(folder / name) for name in texts)}")
    return 0


@app.command
def check(
    file: Path,
    *,
    result: Path | None = None,
    problem: SolvedProblem = None,
    changes: NoChanges = (),
) -> int:
    """Verify an exported motion: integrity, origin and limits.

    The header of the file has hashes of motion, robot, payload and limits. They are compared with
    the result, whose motion is certified and sampled again; every number of the file must match.
    `file`: file of `stiffopt export` of a motion. `result`: folder of the solve; default: the
    folder of the file.
    """
    from stiffopt.export.check import check_file

    refuse_changes(changes)
    found = check_file(file, result or file.parent, problem)
    print(f"{file}: complete and unchanged since `stiffopt export --to {found.format}`.")
    print(
        f"Motion of the {found.which}s of {found.title}, robot {found.robot}"
        f"{'' if found.payload is None else f' with {found.payload:.4g} kg of payload'}, "
        f"{found.duration:.6g} s, {found.samples} samples at {found.rate:g} Hz."
    )
    print(f"All limits are met; the tightest is {found.tightest}.")
    return 0


def _read_numbers(text: str) -> list[float]:
    """Read the numbers of --pulses."""
    try:
        return [float(each) for each in text.split(",")]
    except ValueError as error:
        raise InputError(
            f"--pulses {text}: numbers separated by commas are needed, one for each axis."
        ) from error


def _extended_robot_files(
    result: Path, to: str, recordings: Path, effects: Path | None
) -> Mapping[str, str | bytes]:
    """Return the files of a robot with the findings of a diagnosis; print the changes."""
    from stiffopt.export.model_format import MODEL_FORMATS, notes, read_diagnosed_robot

    found = read_diagnosed_robot(result, recordings, effects)
    exported = MODEL_FORMATS[to].export(found)
    for line in (*notes(found), *exported.remarks):
        print(line)
    return exported.files
