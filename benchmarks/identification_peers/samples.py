"""The samples that peers get of a diagnosed set, and torques of theirs as predictions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.real_peers import Motion
from stiffopt.discovery.comparison.prepared_run import prepare_run
from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.discovery.prediction import Prediction
from stiffopt.recording.run import RecordedRun


def write(diagnosis: Diagnosis, train: list[Motion], test: list[Motion], path: Path) -> None:
    """Write what `given` reads: motions in the peers' own bands, torques of training runs alone."""
    recordings = diagnosis.recordings
    assert recordings.robot.urdf is not None
    bands = sorted(set(train[0].bands))
    arrays: dict[str, np.ndarray] = {
        "urdf": np.array(str(recordings.robot.urdf)),
        "joints": np.array(recordings.joints),
        "band_of": np.array([bands.index(band) for band in train[0].bands]),
        "rotor_inertia": diagnosis.training.robot.rotor_inertia,
    }
    for role, motions in (("train", train), ("test", test)):
        along = [[_followed(diagnosis, each.run, band) for each in motions] for band in bands]
        for k, name in enumerate("qva"):
            values = [np.vstack([run[k] for run in runs]) for runs in along]
            arrays[f"{role}_{name}"] = np.array(values)
        torque = np.vstack([each.run.torque for each in motions])
        arrays[f"{role}_torque"] = torque if role == "train" else np.full_like(torque, np.nan)
        nominal = np.vstack([each.nominal.torque[each.places] for each in motions])
        arrays[f"{role}_nominal"] = nominal
    np.savez(path, **arrays)  # type: ignore[arg-type]


def _followed(diagnosis: Diagnosis, run: RecordedRun, band: float) -> list[np.ndarray]:
    """Position, velocity and acceleration of the motors in one band, each (K, n)."""
    training = diagnosis.training
    blind = replace(run, torque=np.full_like(run.torque, np.nan), link_position=None)
    narrowed = replace(diagnosis.settings, cutoff=band)
    prepared = prepare_run(training.robot, blind, 0, training.constants, narrowed, swinging=False)
    signals = prepared.signals
    return [
        np.column_stack([np.interp(run.time, prepared.time, column) for column in values.T])
        for values in (
            signals.motor_position,
            signals.motor_velocity,
            signals.motor_acceleration,
        )
    ]


def predictions(test: list[Motion], torque: np.ndarray) -> list[Prediction]:
    """Torques of all test samples (K, n) as predictions of their runs."""
    ends = np.cumsum([len(each.run.time) for each in test])[:-1]
    return [
        Prediction(
            stamps=each.run.stamps,
            torque=np.column_stack(
                [np.interp(each.run.stamps, each.run.time, column) for column in part.T]
            ),
            link_position=each.nominal.link_position,
        )
        for each, part in zip(test, np.split(torque, ends), strict=True)
    ]
