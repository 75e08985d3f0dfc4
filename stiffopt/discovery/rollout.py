"""Rollout: recorded commands, simulated by the nominal and by an extended model; its files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stiffopt.discovery.extended.model import ExtendedModel
from stiffopt.discovery.loop_fit import is_commanded
from stiffopt.discovery.position_fit import PositionRun, read_model, simulate_run
from stiffopt.discovery.sanity.command_doubts import take_errors_as_commands
from stiffopt.discovery.store import position_entry
from stiffopt.errors import InputError, InputFileError
from stiffopt.files import SCHEMA, atomic_write, to_json_types, write_csv
from stiffopt.recording.recording_set import RecordingSet


def roll_out(recordings: RecordingSet, model: ExtendedModel) -> tuple[PositionRun, ...]:
    """Simulate all runs of a set from their commands.

    Raises `InputFileError`: the set has no commands, or the model no simulation from commands.
    """
    recordings, _ = take_errors_as_commands(model.applied_to(recordings))
    if recordings.signals.command is None:
        raise InputFileError(
            recordings.path, "signals.command", "names no commanded positions to simulate from."
        )
    if model.closed_loop is None:
        raise InputFileError(
            model.source, "closed_loop", "is missing: this model is of a diagnosis of torques."
            " Diagnose a set with commands."
        )  # fmt: skip
    try:
        simulation = read_model(recordings, model)
    except InputError as error:
        raise InputFileError(model.source, "", str(error)) from error
    runs = [recordings.open(entry) for entry in recordings.runs]
    found = tuple(simulate_run(recordings, simulation, run) for run in runs if is_commanded(run))
    if not found:
        raise InputFileError(recordings.path, "runs", "no run holds commands and all positions.")
    return found


def write_rollout(runs: Sequence[PositionRun], joints: Sequence[str], folder: Path) -> None:
    """Write the positions of each run as CSV [s], [rad], and rollout.json with their errors."""
    kinds = ("command", "measured", "before", "after")
    head = ["time", *(f"{kind}_{joint}" for kind in kinds for joint in joints)]
    for run in runs:
        rows = np.column_stack([run.time, *(getattr(run, kind) for kind in kinds)])
        write_csv(folder / f"{run.name}.csv", head, rows)
    document = {"schema": SCHEMA, "runs": [position_entry(run) for run in runs]}
    text = json.dumps(to_json_types(document), indent=1, allow_nan=False)
    atomic_write(folder / "rollout.json", text + "\n")
