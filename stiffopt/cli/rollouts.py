"""`stiffopt rollout`: simulation of recorded commands."""

from __future__ import annotations

from pathlib import Path

from stiffopt.cli.base import Changes, Out, app, default_folder
from stiffopt.errors import InputFileError
from stiffopt.folders import output_folder


@app.command
def rollout(
    recordings: Path,
    *,
    model: Path,
    out: Out | None = None,
    changes: Changes = (),
) -> int:
    """Simulate what the arm would have done on the recorded commands, before and after a diagnosis.

    Writes rollout.json, and for each run its positions as CSV and a picture of command, measured
    and simulated positions. A simulation sees the commands and the first position of a run alone.

    Parameters
    ----------
    recordings
        Recording set with commands: its folder or its recordings.toml.
    model
        extended.toml of a diagnosis of this arm from commands.
    out
        Folder for the results; default: out/NAME-rollout of the set's folder.
    """
    from stiffopt.discovery.extended.model import load_extended
    from stiffopt.discovery.rollout import roll_out, write_rollout
    from stiffopt.recording.recording_set import load_recordings
    from stiffopt.report.common.svg import to_png
    from stiffopt.report.common.terminal import print_lines, print_table
    from stiffopt.report.diagnosis.position_figure import position_figure
    from stiffopt.report.diagnosis.positions import position_section

    loaded = load_recordings(recordings, changes)
    home = loaded.path.parent.resolve()
    folder = out or default_folder(f"{home.name}-rollout", changes)
    if home in (folder.resolve(), *folder.resolve().parents):
        raise InputFileError(
            folder, "", f"lies in the recording set {home}, which is read-only. Give another --out."
        )
    with output_folder(folder, "rollout") as stage:
        runs = roll_out(loaded, load_extended(model))
        for run in runs:
            figure = position_figure(run, loaded.joints, loaded.prismatic)
            (stage / f"{run.name}.png").write_bytes(to_png(figure))
        write_rollout(runs, loaded.joints, stage)
    section = position_section(runs, loaded.prismatic)
    print_table(section.head, section.rows, title=section.title)
    print_lines([f"{len(runs)} run(s) of {loaded.path} simulated.", f"Files: {folder}"])
    return 0
