"""Torques from commanded positions: the actuator's law along a recorded motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.actuator.law import ActuatorLaw, mean_command
from stiffopt.recording.run import RecordedRun

# Half the window over which the slope of the encoder is the velocity that damps [s].
_HALF_SLOPE_WINDOW = 0.01


def derive_torque(run: RecordedRun, law: ActuatorLaw | None) -> RecordedRun:
    """Return a run with the torques of an actuator's law in place of missing ones.

    Unknown gains (and a joint without commands) leave a torque missing. While the delay is not
    known, none is assumed.
    """
    if law is None or run.command is None:
        return run
    delay = law.delay if np.isfinite(law.delay) else 0.0
    error = delayed_command(run, delay) - run.position
    return replace(run, torque=np.asarray(law.torque(error, encoder_velocity(run))))


def delayed_command(run: RecordedRun, delay: float) -> np.ndarray:
    """Return the commands (K, n) that act at each sample, as means over one step [rad]."""
    assert run.command is not None
    half = 0.5 * run.step
    command = np.empty_like(run.command)
    for j, own in enumerate(run.command.T):
        known = np.isfinite(own)
        if not known.any():
            command[:, j] = np.nan
            continue
        times, held = run.time[known], own[known, None]
        begin, end = run.time - delay - half, run.time - delay + half
        command[:, j] = mean_command(times, held, begin, end)[0][:, 0]
    return command


def encoder_velocity(run: RecordedRun) -> np.ndarray:
    """Return the slope (K, n) of the encoders, one-sided at the ends [rad/s]."""
    width = max(1, round(_HALF_SLOPE_WINDOW / run.step))
    rows = np.arange(len(run.time))
    before, after = np.maximum(rows - width, 0), np.minimum(rows + width, len(rows) - 1)
    span = (run.time[after] - run.time[before])[:, None]
    return np.asarray((run.position[after] - run.position[before]) / span)
