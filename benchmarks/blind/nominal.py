"""The nominal model of a recording set evaluated along a run, apart from the tool's own code.

Rivals and controls start from it: the same rigid bodies, friction and wind-up as the set states.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.signal import butter, sosfiltfilt

from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun

# Of the smooth sign of a speed [rad/s].
SIGN_SPEED = 0.01
# Of a run that its filter spoils [s].
_ENDS = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A run's motion and what the nominal model says along it; arrays (K, n), SI.

    `rigid` is the torque of the bodies, `torque` that of the drives, `windup` motor less link
    angle. `moving`: faster than 0.03 rad/s, and not at the ends of the run, where the filter of
    the motion has one side only.
    """

    time: np.ndarray
    session_time: float
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    rigid: np.ndarray
    torque: np.ndarray
    windup: np.ndarray
    moving: np.ndarray
    measured: np.ndarray


def along(recordings: RecordingSet, run: RecordedRun, cutoff: float) -> Motion:
    """Evaluate the nominal model along a run.

    Parameters
    ----------
    recordings : RecordingSet
    run : RecordedRun
        Evenly sampled.
    cutoff : float
        Of the zero-phase low-pass on the motion [Hz].
    """
    robot, order = recordings.robot, recordings.order
    step = float(np.median(np.diff(run.time)))
    low_pass = butter(3, cutoff, fs=1.0 / step, output="sos")
    position = sosfiltfilt(low_pass, _bridged(run.time, run.position), axis=0)
    velocity = np.gradient(position, step, axis=0)
    acceleration = sosfiltfilt(low_pass, np.gradient(velocity, step, axis=0), axis=0)
    rigid = _rnea(recordings, position, velocity, acceleration)
    windup = _windup(recordings, rigid)
    # Links move less than motors by the wind-up, which matters where they accelerate.
    link = sosfiltfilt(low_pass, position - windup, axis=0)
    link_velocity = np.gradient(link, step, axis=0)
    link_acceleration = sosfiltfilt(low_pass, np.gradient(link_velocity, step, axis=0), axis=0)
    rigid = _rnea(recordings, link, link_velocity, link_acceleration)
    friction = robot.coulomb[order] * np.tanh(velocity / SIGN_SPEED)
    friction += robot.viscous[order] * velocity
    inside = (run.time > run.time[0] + _ENDS) & (run.time < run.time[-1] - _ENDS)
    recorded = velocity if run.velocity is None else run.velocity
    return Motion(
        time=run.time,
        session_time=run.session_time or 0.0,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        rigid=rigid,
        torque=robot.rotor_inertia[order] * acceleration + rigid + friction,
        windup=_windup(recordings, rigid),
        moving=(np.abs(recorded) >= 3.0 * SIGN_SPEED) & inside[:, None],
        measured=run.torque,
    )


def _bridged(time: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Samples (K, n) with those that were left out drawn straight."""
    columns = []
    for column in samples.T:
        known = np.isfinite(column)
        columns.append(np.interp(time, time[known], column[known]))
    return np.column_stack(columns)


def _rnea(recordings: RecordingSet, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Inverse dynamics of the bodies (K, n) in the set's order of joints."""
    model, order = recordings.robot.model, recordings.order
    data = model.createData()
    turned = [np.zeros_like(q) for _ in range(3)]
    for own, given in zip(turned, (q, v, a), strict=True):
        own[:, order] = given
    torque = np.array([pin.rnea(model, data, *lines) for lines in zip(*turned, strict=True)])
    return torque[:, order]


def _windup(recordings: RecordingSet, torque: np.ndarray) -> np.ndarray:
    """Wind-up of reducers and contacts under a torque (K, n) [rad]."""
    stated = recordings.stated
    total = np.zeros_like(torque)
    if stated.contact_stiffness is not None:
        total += torque / np.array(stated.contact_stiffness)
    if stated.reducer is None:
        return total
    r, size = stated.reducer, np.abs(torque)
    k1, k2, k3, t1, t2 = (np.array(numbers) for numbers in (r.K1, r.K2, r.K3, r.T1, r.T2))
    curve = np.minimum(size, t1) / k1
    curve += np.clip(size - t1, 0.0, t2 - t1) / k2
    curve += np.maximum(size - t2, 0.0) / k3
    return np.asarray(total + np.sign(torque) * curve)
