"""Decimation of long recordings: means of several samples in place of the samples.

Joint motion and friction lie below some tens of hertz: ten minutes at 1 kHz contain no more of them
than at a third of the rate, at three times the memory and time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun


def decimation_factor(runs: Sequence[RecordedRun]) -> int:
    """Odd number of samples per mean; 1 except for long recordings.

    `runs`: training runs.
    """
    fastest = min((1.0 / run.step for run in runs), default=0.0)
    # Samples of all training runs above which they are decimated, and the lowest decimated rate
    # [Hz].
    most = int(fastest / 200.0)
    wanted = int(np.ceil(sum(len(run.time) for run in runs) / 160_000))
    every = min(wanted + (wanted % 2 == 0), most - (most % 2 == 0))
    return max(1, every)


def sampling_rate(runs: Sequence[RecordedRun]) -> float:
    """Mean sampling rate of some runs [Hz]."""
    return float(sum(len(run.time) for run in runs) / sum(len(run.time) * run.step for run in runs))


def decimate_run(run: RecordedRun, every: int) -> RecordedRun:
    """Decimate a run to means of `every` samples at their middle stamp.

    `every`: odd; 1 returns the run unchanged. All stamps are kept for predictions. A mean that
    contains a NaN is NaN; means over gaps are removed.
    """
    count = len(run.time) // every
    if every == 1 or not count:
        return run
    groups = run.time[: count * every].reshape(count, every)
    # Duration of the samples of a mean over that without gaps; means over gaps are removed.
    whole = np.ptp(groups, axis=1) < 1.5 * every * run.step

    def means(samples: np.ndarray | None) -> np.ndarray | None:
        if samples is None:
            return None
        of_group = samples[: count * every].reshape(count, every, -1)
        return np.asarray(of_group.mean(axis=1)[whole])

    position, torque = means(run.position), means(run.torque)
    assert position is not None
    assert torque is not None
    return replace(
        run,
        time=groups[whole, every // 2],
        position=position,
        torque=torque,
        velocity=means(run.velocity),
        link_position=means(run.link_position),
        command=means(run.command),
    )


def decimate_noise(recordings: RecordingSet, every: int) -> RecordingSet:
    """Recording set with the sensor noise of means of `every` samples."""
    if every == 1:
        return recordings
    root = np.sqrt(every)
    noise = recordings.noise
    stated = {
        name: None if (own := getattr(noise, name)) is None else own / root
        for name in ("torque", "velocity", "link_position")
    }
    return replace(recordings, noise=replace(noise, **stated))


def describe_decimation(runs: Sequence[RecordedRun], every: int) -> str:
    """Sentence of the report on the decimation of these runs (before it)."""
    number = sum(len(run.time) for run in runs)
    left = min(1.0 / run.step for run in runs) / every
    return (
        f"The training runs hold {number} samples: means of {every} are compared ({left:.0f} Hz),"
        f" and nothing faster than {0.5 * left:.0f} Hz is seen."
    )
