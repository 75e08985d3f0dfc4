"""Open a set for a diagnosis: actuators, sampling rate, catalogue, and plausibility of its runs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

from stiffopt.closed_loop.parameters import Parameters
from stiffopt.discovery.catalogue import changes_in, effects_of_runs
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.extended.left_open import rescale_to_rate
from stiffopt.discovery.extended.model import ExtendedModel, load_extended
from stiffopt.discovery.progress import Say
from stiffopt.discovery.sanity.actuator_estimate import resolve_actuator
from stiffopt.discovery.sanity.command_doubts import take_errors_as_commands
from stiffopt.discovery.sanity.doubt import Doubt
from stiffopt.discovery.sanity.gate import judge_plausibility, leave_out_unscaled
from stiffopt.discovery.training import open_training_runs
from stiffopt.recording.decimation import (
    decimate_noise,
    decimate_run,
    decimation_factor,
    describe_decimation,
    sampling_rate,
)
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.recording.state_pair import StatePair


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenedSet:
    """A set whose training runs are read, understood and plausible."""

    recordings: RecordingSet
    base: ExtendedModel | None  # model that the diagnosis starts from
    catalogue: tuple[Effect, ...]  # with those of single runs, and of changes between two states
    runs: list[RecordedRun]  # training runs, as compared
    recorded: list[RecordedRun]  # the same runs at the rate of their files
    clock: float  # that rate [Hz]
    every: int  # one of so many samples is compared
    actuator: Parameters | None  # of a simulation that told gains and delay
    notes: tuple[str, ...]
    doubts: tuple[Doubt, ...]
    remarks: tuple[Doubt, ...]

    @property
    def at_rest(self) -> bool:
        """True for poses at rest."""
        return self.runs[0].at_rest

    def assumptions(self) -> tuple[str, ...]:
        """Return what was taken for granted, one sentence each."""
        return (
            *(f"Diagnosed despite a doubt: {doubt.evidence}" for doubt in self.doubts),
            *(f"to be checked: {each}" for each in self.remarks),
            *self.notes,
        )


def open_set(
    recordings: RecordingSet,
    catalogue: Sequence[Effect],
    extra: Sequence[Effect],
    model: ExtendedModel | str | os.PathLike[str] | None,
    say: Say,
    *,
    despite_doubts: bool,
) -> OpenedSet:
    """Open the training runs of a set, and no other run."""
    base = load_extended(model, extra) if isinstance(model, str | os.PathLike) else model
    if base is not None:
        recordings = base.applied_to(recordings)
    recordings, taken = take_errors_as_commands(recordings)
    resolved = resolve_actuator(recordings, open_training_runs(recordings, say), say)
    recordings, recorded = resolved.recordings, resolved.runs
    after = recordings.runs_after if isinstance(recordings, StatePair) else ()
    known = effects_of_runs((*catalogue, *extra), [run.name for run in recorded], after)
    if after:
        known = (*known, *changes_in(known, after))
    every, clock = decimation_factor(recorded), sampling_rate(recorded)
    thin = () if every == 1 else (describe_decimation(recorded, every),)
    if base is not None and base.left_open is not None:
        left_open = rescale_to_rate(rescale_to_rate(base.left_open, clock), clock / every)
        base = replace(base, left_open=left_open)
    recordings = decimate_noise(recordings, every)
    runs = [decimate_run(run, every) for run in recorded]
    say("check units, signs and orders")
    doubts, remarks = judge_plausibility(
        recordings, runs, despite_doubts=despite_doubts, remarks=base is None
    )
    recordings, runs = leave_out_unscaled(recordings, runs)
    return OpenedSet(
        recordings=recordings,
        base=base,
        catalogue=known,
        runs=runs,
        recorded=recorded,
        clock=clock,
        every=every,
        actuator=resolved.parameters,
        notes=(*thin, *taken, *resolved.notes),
        doubts=doubts,
        remarks=remarks,
    )
