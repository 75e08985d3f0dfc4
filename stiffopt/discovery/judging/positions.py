"""Proof by simulation: held-out runs from their commands alone, judged by the error of position."""

from __future__ import annotations

from collections.abc import Sequence

from stiffopt.closed_loop.parameters import Parameters
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.extended.value_changes import extended_model
from stiffopt.discovery.loop_fit import is_commanded
from stiffopt.discovery.position_fit import (
    ClosedLoopModel,
    PositionRun,
    fit_positions,
    simulate_run,
)
from stiffopt.discovery.progress import Say
from stiffopt.discovery.training import Training
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.recording.state_pair import StatePair


def fit_simulation(
    recordings: RecordingSet,
    training: Training,
    found: Extension,
    runs: Sequence[RecordedRun],
    estimated: Parameters | None,
    say: Say,
) -> ClosedLoopModel | None:
    """Fit the simulation from commands, beginning with friction and rotors as found.

    Joints without a scale of torque, of which nothing is found, begin as `estimated`.

    None where no training run holds commands of joints with known gains, and for two states of a
    robot, of which one simulation is none.
    """
    if isinstance(recordings, StatePair):
        return None
    say("simulate the training runs from their commands")
    model = extended_model(recordings, training.constants, found)
    return fit_positions(recordings, runs, model, estimated, say)


def simulate_held_out(
    recordings: RecordingSet, loop: ClosedLoopModel | None
) -> tuple[PositionRun, ...]:
    """Simulate held-out runs from their commands."""
    if loop is None:
        return ()
    runs = (recordings.open(entry) for entry in recordings.with_role("test", "extrapolate"))
    return tuple(simulate_run(recordings, loop, run) for run in runs if is_commanded(run))
