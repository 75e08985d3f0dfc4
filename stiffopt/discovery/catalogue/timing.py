"""Signals read at other instants: torque late or ahead of the motion, or on another clock.

A measured torque is late by its filter and its way through the bus. It is never ahead of the motion
that it causes: a torque that is ahead was commanded, and recorded in place of the measured one.
"""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import first_order_lag
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term, Values
from stiffopt.discovery.signals import RobotSignals

# Shortest shift [s] whose slope rounding errors leave exact.
_SHORTEST_SHIFT = 1e-9
# Longest delay, lead, and offset of the clock of one run [s]; the plausibility check finds longer
# ones.
MAX_CLOCK_OFFSET = 0.2
# Largest relative difference of two clocks: 1 % is a rate in the place of another; crystals agree
# to 1e-4.
_MAX_RATE_DIFFERENCE = 0.01


def shift_slope(
    values: np.ndarray, dt: float, shift: float, growth: np.ndarray | float = 1.0
) -> np.ndarray:
    """Return (values(t - shift) - values(t))/shift (K, n), per unit of the shift.

    `values` (K, n): at uniform instants. `dt` [s]. `shift` [s], or relative where it grows with the
    time. `growth` (K,): factor on the shift at every instant: 1, or the time [s].
    """
    shift = shift if abs(shift) >= _SHORTEST_SHIFT else _SHORTEST_SHIFT
    return np.asarray((shift_samples(values, shift / dt * growth) - values) / shift)


def delay_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return tau(t - d) - tau(t) of all joints, linear in d about the delay of the shape."""
    slope = shift_slope(signals.drive_torque, signals.dt, shapes[0])
    return Term(drive_torque=amplitudes[0] * slope)


def joint_delay_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return tau(t - d) - tau(t) of the joint alone, as `delay_term`."""
    drive, own = signals.drive_torque, slice(signals.link, signals.link + 1)
    late = np.zeros_like(drive)
    late[:, own] = amplitudes[0] * shift_slope(drive[:, own], signals.dt, shapes[0])
    return Term(drive_torque=late)


def reading_filter_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the first-order lag of all torques less these, linear in T about the shape."""
    drive, ratio = signals.drive_torque, max(shapes[0], _SHORTEST_SHIFT) / signals.dt
    kept = np.exp(-1.0 / ratio)
    # Between samples torques are straight lines, not steps: the lag is T at any sampling rate.
    within = (kept / (1.0 - kept) - ratio) * np.diff(drive, axis=0, prepend=drive[:1])
    lag = first_order_lag(drive + within, kept)
    return Term(drive_torque=amplitudes[0] * (lag - drive) / (ratio * signals.dt))


def shift_samples(values: np.ndarray, samples: np.ndarray | float) -> np.ndarray:
    """Return values (K, n) of earlier instants, by cubic convolution; constant beyond the ends.

    `values` (K, n): at uniform instants. `samples` (K,): delay in samples; negative for later
    instants.
    """
    places = np.arange(len(values)) - np.asarray(samples, dtype=float)
    before = np.floor(places).astype(int)
    found = np.zeros_like(values)
    for tap in range(-1, 3):
        rows = np.clip(before + tap, 0, len(values) - 1)
        found += _cubic_weight(places - before - tap)[:, None] * values[rows]
    return found


def _cubic_weight(away: np.ndarray) -> np.ndarray:
    """Return the weight of a sample at a distance in samples (Keys 1981)."""
    near, far = np.fmin(np.abs(away), 1.0), np.fmin(np.fmax(np.abs(away), 1.0), 2.0)
    inner = 1.5 * near**3 - 2.5 * near**2 + 1.0
    return np.asarray(inner - 0.5 * far**3 + 2.5 * far**2 - 4.0 * far + 2.0)


def clock_drift_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return tau(t - d - e t) - tau(t) of all joints, linear in e about the shape, and in d."""
    elapsed = signals.time - signals.time[0]
    drift = shift_slope(signals.drive_torque, signals.dt, shapes[0], elapsed)
    return Term(drive_torque=amplitudes[0] * drift - amplitudes[1] * signals.drive_torque_rate)


def _shift_about(unit: str, sizes: tuple[float, ...], most: float, usual: float) -> Shape:
    """Return the shift that a term is linear about, tried with both signs."""
    starts = (*(-size for size in reversed(sizes)), *sizes)
    return Shape("about", unit, starts, -most, most, usual, reported=False)


TIME_DELAY = Effect(
    name="time_delay",
    family="sensor",
    scope="robot",
    equation="tau += tau(t - d) - tau(t)",
    signature="motor torques of all joints late by the same time, or early as commanded torques"
    " are",
    phrase=(
        "torque recorded {d} late",
        "torque recorded {d} ahead of the motion, as a commanded torque is",
    ),
    remedy="Shift the torque channels by {d}, use one clock for all signals, and record the"
    " measured torque where it is ahead of the motion.",
    needs=("torque", "torque_sensor", "moves"),
    reads_torque=True,
    term=delay_term,
    amplitudes=(Amplitude("d", "s", 5e-3, -40.0, 40.0),),
    shapes=(_shift_about("s", (2e-4, 1e-3, 5e-3, 0.02, 0.08), MAX_CLOCK_OFFSET, 1e-4),),
    linear_about=True,
    signals_key="torque_delay",
    separate="Change speed quickly, then hold it: a delay shows while the torque changes, friction"
    " and inertia do not depend on how fast it does. Ahead of the motion is a command: read the"
    " name of its column in the manual, and record the measured current as well.",
)

JOINT_DELAY = Effect(
    name="joint_delay",
    family="sensor",
    scope="joint",
    couples_joints=True,
    equation="tau += tau(t - d) - tau(t) in one joint",
    signature="motor torque of one joint late or early, by a time that no other joint shows",
    title="torque of one joint late",
    phrase=("torque of one joint recorded {d} late", "torque of one joint recorded {d} early"),
    remedy="Shift the torque channel of {where} by {d}, and look for a filter or a bus segment that"
    " only this joint has.",
    needs=("torque", "torque_sensor", "moves"),
    confused_with=("time_delay", "viscous"),
    reads_torque=True,
    term=joint_delay_term,
    amplitudes=TIME_DELAY.amplitudes,
    shapes=TIME_DELAY.shapes,
    linear_about=True,
    # Of one joint, it is that of all.
    applies=lambda constants: constants.joints > 1,
    separate="Move all joints together and change speed quickly: of a delay that all joints share,"
    " every torque shows the same.",
)

READING_FILTER = Effect(
    name="reading_filter",
    family="sensor",
    scope="robot",
    equation="tau += y - tau, y + T*dy/dt = tau",
    signature="motor torques of all joints late and rounded where they change fast",
    title="filtered torque",
    phrase="torque readings pass a filter with a time constant of {T}",
    remedy="Record torques without the filter, or the positions with the same one: first order,"
    " time constant {T}.",
    needs=("torque", "torque_sensor", "moves"),
    confused_with=("time_delay", "viscous"),
    reads_torque=True,
    term=reading_filter_term,
    amplitudes=(Amplitude("T", "s", 5e-3, 0.0, 40.0),),
    shapes=(
        Shape("about", "s", (1e-3, 5e-3, 0.02, 0.08), 0.0, MAX_CLOCK_OFFSET, 1e-4, reported=False),
    ),
    linear_about=True,
    # Of a short filter only its delay shows, which a bus has as well.
    log_prior=lambda constants: -2.0,
    separate="Change speed quickly, then hold it: behind a delay torque changes as fast as the"
    " motion, behind a filter it creeps to its value.",
)

COMMAND_DELAY = Effect(
    name="command_delay",
    family="sensor",
    scope="joint",
    equation="tau += d*k*dcmd/dt",
    signature="torque ahead of the motion in proportion to the rate of the commands, in one joint",
    title="commands of one joint delayed",
    phrase="commands act {d} later than assumed, beyond the delay of all joints",
    remedy="Look for a bus segment, filter or interpolation that only {where} has.",
    needs=("commanded", "moves"),
    confused_with=("viscous",),
    # A planned motion has no law: its commands change with the torque alone.
    term=lambda signals, a, s: Term(
        drive_torque=a[0]
        * (signals.drive_torque_rate if signals.command_rate is None else signals.command_rate)
    ),
    amplitudes=(Amplitude("d", "s", 5e-3, 0.0, 10.0),),
    separate="Step the command and hold it: a delay shows at the step alone, friction while the"
    " joint moves.",
)

CLOCK_DRIFT = Effect(
    name="clock_drift",
    family="sensor",
    scope="robot",
    equation="tau += tau(t - d - e*t) - tau(t)",
    signature="motor torques of all joints late or early by a time that grows in proportion to the"
    " time of the run",
    title="clock drift between torque and position",
    phrase=(
        "torques recorded ever later than positions, by {e:%} of the time of a run",
        "torques recorded ever earlier than positions, by {e:%} of the time of a run",
    ),
    remedy="Record torques and positions with one clock: those of the recordings differ by {e:%}.",
    needs=("torque", "torque_sensor", "moves"),
    confused_with=("time_delay",),
    reads_torque=True,
    term=clock_drift_term,
    amplitudes=(
        Amplitude("e", "", 1e-3, -10.0, 10.0, own=True),
        Amplitude("d", "s", 5e-3, -10.0, 10.0),
    ),
    shapes=(_shift_about("", (2e-4, 1e-3, 4e-3), _MAX_RATE_DIFFERENCE, 1e-5),),
    linear_about=True,
    separate="Record one short motion at the start and again at the end of a long run: the delay of"
    " a constant offset is equal in both, that of two clocks is not.",
)

RUN_CLOCK = Effect(
    name="run_clock",
    family="sensor",
    scope="recording",
    equation="tau += tau(t - d) - tau(t) in one run",
    signature="motor torques of all joints late or early by the same time, in one run alone",
    title="torque of one run on another clock",
    phrase=(
        "torque of one run recorded {d} late",
        "torque of one run recorded {d} early",
    ),
    remedy="Shift the torque columns of that run by {d}, or leave it out.",
    needs=("torque", "torque_sensor", "moves", "runs"),
    confused_with=("time_delay",),
    reads_torque=True,
    term=delay_term,
    amplitudes=(Amplitude("d", "s", 0.02, -10.0, 10.0),),
    shapes=(_shift_about("s", (1e-3, 0.005, 0.02, 0.08), MAX_CLOCK_OFFSET, 1e-4),),
    linear_about=True,
    separate="Repeat the run with one clock for all signals: a cause in the robot stays.",
)

TIMING = (TIME_DELAY, JOINT_DELAY, READING_FILTER, COMMAND_DELAY, CLOCK_DRIFT, RUN_CLOCK)
