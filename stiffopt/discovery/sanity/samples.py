"""Some hundred instants of the training runs: motion and torques, filtered alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.filtering import (
    ZeroPhaseFilter,
    bridge_gaps,
    derivative,
    near_gaps,
    resample_uniform,
)
from stiffopt.recording.run import RecordedRun

# Instants of all runs together: enough for a dozen columns, few enough to try many descriptions.
_INSTANTS = 900
# Units and orders show in slow motion, where neither noise nor what swings matters [Hz].
_CUTOFF = 8.0


@dataclass(frozen=True, eq=False)
class TorqueSeries:
    """Torques of one run on its own clock, to be read earlier or later.

    Parameters
    ----------
    time : array (K,) [s]
    torque : array (K, n)
        Filtered [N m]; nan where a joint has none.
    at : array (m,)
        The instants of the run [s].
    """

    time: np.ndarray
    torque: np.ndarray
    at: np.ndarray

    def shifted(self, delay: float) -> np.ndarray:
        """Torques (m, n) that were recorded `delay` after the instants."""
        when = self.at + delay
        return np.column_stack([np.interp(when, self.time, column) for column in self.torque.T])


@dataclass(frozen=True, eq=False)
class Samples:
    """Instants of the runs.

    Parameters
    ----------
    position, velocity, acceleration, torque : array (m, n)
        As recorded, in the order of the set; torque is nan where a joint has none.
    series : tuple of TorqueSeries
        One a run.
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    series: tuple[TorqueSeries, ...]

    def torque_after(self, delay: float) -> np.ndarray:
        """Torques (m, n) recorded `delay` [s] after the motion."""
        return np.vstack([each.shifted(delay) for each in self.series])


def sampled(runs: Sequence[RecordedRun]) -> Samples | None:
    """Instants of the usable runs, None where they are too short."""
    usable = [run for run in runs if run.usable]
    every = max(1, _INSTANTS // max(1, len(usable)))
    motions, series = [], []
    for run in usable:
        time, position, _, torque = resample_uniform(run)
        dt = float(time[1] - time[0])
        low_pass = ZeroPhaseFilter(1.0 / dt, min(_CUTOFF, 0.2 / dt))
        inside = np.arange(low_pass.settling, len(time) - low_pass.settling)
        bridged = near_gaps(_stamps_of_all(run), run.step, time, low_pass.settling)
        inside = inside[~bridged[inside]]
        if len(inside) < 20:
            continue
        places = inside[np.linspace(0, len(inside) - 1, min(every, len(inside))).astype(int)]
        q = low_pass.filter_motion(bridge_gaps(position))
        v = derivative(q, dt)
        motions.append(np.stack([q, v, derivative(v, dt)])[:, places])
        smooth = low_pass(bridge_gaps(torque))
        series.append(TorqueSeries(time, smooth, time[places]))
    if not motions:
        return None
    q, v, a = np.concatenate(motions, axis=1)
    measured = np.vstack([each.shifted(0.0) for each in series])
    return Samples(q, v, a, measured, tuple(series))


def _stamps_of_all(run: RecordedRun) -> np.ndarray:
    """Times at which no channel lacks a number that it has at others."""
    channels = np.hstack([run.position, run.torque])
    known = np.isfinite(channels)
    return np.asarray(run.time[(known | ~known.any(axis=0)).all(axis=1)])
