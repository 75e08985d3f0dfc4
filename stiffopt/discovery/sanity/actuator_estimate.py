"""Gains and delay of an actuator from commands and motion, where the arm's weight tells them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.actuator.law import ActuatorLaw
from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter, bridge_gaps, derivative
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.doubt import format_joints
from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.discovery.signals import smooth_sign
from stiffopt.formatting import pm
from stiffopt.recording.commanded import delayed_command, derive_torque
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun

# Cutoff of the filter [Hz]: weight and friction show in slow motion.
_FILTER_CUTOFF = 8.0
# Delays that are tried [s]: a fieldbus needs some milliseconds, a serial bus of servos some tens.
_DELAYS = np.arange(0.0, 0.0605, 0.0025)
# Log likelihood ratio from which a delay is taken to differ from none.
_MIN_DELAY_EVIDENCE = 6.0
# Largest relative standard deviation of a gain that the weight tells.
_MAX_GAIN_DEVIATION = 0.1
# Fewest moving instants of a joint.
_MIN_INSTANTS = 60
# Stretches that are left out in turn: physics that the regressors lack differs between them.
_STRETCHES = 8


@dataclass(frozen=True, eq=False)
class _JointRows:
    """Rows of one joint: regressors (m, k), weight and inertia (m,), errors by delay (d, m)."""

    columns: np.ndarray
    load: np.ndarray
    velocity: np.ndarray
    errors: np.ndarray
    independent: float


@dataclass(frozen=True, eq=False)
class ActuatorEstimate:
    """Law of an actuator with its unknown values estimated.

    Parameters
    ----------
    law : ActuatorLaw
        A gain that nothing tells stays nan.
    deviation : array (n,)
        One standard deviation of each estimated gain, relative; 0 for stated ones.
    notes : tuple of str
        What was estimated, one sentence each.
    """

    law: ActuatorLaw
    deviation: np.ndarray
    notes: tuple[str, ...]


def resolve_actuator(
    recordings: RecordingSet, runs: Sequence[RecordedRun]
) -> tuple[RecordingSet, list[RecordedRun], tuple[str, ...]]:
    """Return a set and its runs with torques by the estimated law, and what was estimated.

    Sets with recorded torques, or with a law that is known, are returned unchanged.
    """
    law = recordings.actuator
    if law is None:
        return recordings, list(runs), ()
    notes: tuple[str, ...] = ("Torques are not recorded: the actuator's law gives them.",)
    if not law.known:
        found = estimate_actuator(RobotModel(recordings), runs, law)
        law, notes = found.law, (*notes, *found.notes)
    known = recordings.with_actuator(law)
    return known, [derive_torque(run, law) for run in runs], notes


def estimate_actuator(
    robot: RobotModel, runs: Sequence[RecordedRun], law: ActuatorLaw
) -> ActuatorEstimate:
    """Estimate unknown gains and the delay by least squares of the equation of motion.

    With an unknown gain k the position error is (weight and inertia + friction + ...) / k: masses
    are known, so that the factor of their torque is 1 / k. Their tolerance is that of the gain.
    """
    rows = [_joint_rows(robot, runs, j) for j in range(robot.n)]
    delay, evidence = law.delay, np.inf
    if not np.isfinite(delay):
        delay, evidence = _estimate_delay(rows, law)
    at = int(np.argmin(np.abs(_DELAYS - delay)))
    stiffness, deviation = law.stiffness.copy(), np.zeros(robot.n)
    for j, own in enumerate(rows):
        if np.isfinite(stiffness[j]) or own is None:
            continue
        factor, spread = _load_factor(own, at)
        if factor > 0.0 and spread < _MAX_GAIN_DEVIATION * factor:
            stiffness[j], deviation[j] = 1.0 / factor, spread / factor
    return ActuatorEstimate(
        law=replace(law, stiffness=stiffness, delay=delay),
        deviation=deviation,
        notes=tuple(_describe(law, stiffness, deviation, delay, evidence)),
    )


def _describe(
    law: ActuatorLaw, stiffness: np.ndarray, deviation: np.ndarray, delay: float, evidence: float
) -> list[str]:
    asked = ~np.isfinite(law.stiffness)
    told = asked & np.isfinite(stiffness)
    notes = []
    if told.any():
        each = ", ".join(
            f"joint {j + 1}: {pm(stiffness[j], deviation[j] * stiffness[j], 'N m/rad')}"
            for j in np.flatnonzero(told)
        )
        notes.append(
            f"The gain of the position error is estimated from the arm's weight ({each}): its scale"
            " is that of the nominal masses. What damps by velocity counts as viscous friction."
        )
    if (silent := asked & ~np.isfinite(stiffness)).any():
        which = format_joints(np.flatnonzero(silent))
        notes.append(
            f"Weight and inertia do not tell the gain of {which}: torques there have no scale and"
            " are left out. Give kp in [actuator]; only ratios of friction to gain are known."
        )
    if not np.isfinite(law.delay):
        notes.append(
            f"The delay of commands is estimated to {1e3 * delay:.3g} ms."
            if evidence > _MIN_DELAY_EVIDENCE
            else "No delay of commands is assumed: the motion does not tell one."
        )
    return notes


def _joint_rows(robot: RobotModel, runs: Sequence[RecordedRun], joint: int) -> _JointRows | None:
    """Return the filtered rows of one joint over all runs; None if it hardly moves."""
    parts: list[tuple[np.ndarray, ...]] = []
    seconds = 0.0
    for run in runs:
        low_pass = ZeroPhaseFilter(1.0 / run.step, min(_FILTER_CUTOFF, 0.2 / run.step))
        inside = slice(low_pass.settling, len(run.time) - low_pass.settling)
        if run.command is None or not np.isfinite(run.command[:, joint]).any() or not run.usable:
            continue
        position = low_pass.filter_motion(bridge_gaps(run.position))
        velocity = derivative(position, run.step)
        acceleration = derivative(velocity, run.step)
        load = robot.spring_torque(position, velocity, acceleration)[:, joint]
        own, speed, rate = (x[:, joint] for x in (position, velocity, acceleration))
        errors = [
            low_pass(delayed_command(run, delay)[:, joint : joint + 1])[:, 0] - own
            for delay in _DELAYS
        ]
        direction = smooth_sign(speed)
        columns = np.column_stack(
            [rate, speed, direction, np.abs(load) * direction, np.ones_like(own)]
        )
        moving = np.abs(speed[inside]) >= MIN_MOVING_SPEED
        parts.append(tuple(x[inside][moving] for x in (columns, load, speed, np.array(errors).T)))
        seconds += float(moving.sum()) * run.step
    if not parts or sum(len(part[0]) for part in parts) < _MIN_INSTANTS:
        return None
    columns, load, speed, stacked = (np.concatenate(each) for each in zip(*parts, strict=True))
    return _JointRows(columns, load, speed, stacked.T, max(2.0 * _FILTER_CUTOFF * seconds, 1.0))


def _estimate_delay(rows: Sequence[_JointRows | None], law: ActuatorLaw) -> tuple[float, float]:
    """Return the likeliest delay [s] and its log likelihood ratio to none; 0 where none shows."""
    misfit = np.zeros(len(_DELAYS))
    for j, own in enumerate(rows):
        if own is None:
            continue
        for k, error in enumerate(own.errors):
            if np.isfinite(law.stiffness[j]):
                target = law.stiffness[j] * error - law.damping[j] * own.velocity - own.load
                left = _least_squares(own.columns, target, own.independent)[2]
            else:
                table = np.column_stack([own.load, own.columns])
                left = _least_squares(table, error, own.independent)[2]
            misfit[k] += 0.5 * own.independent * np.log(max(left, 1e-300))
    best = int(np.argmin(misfit))
    evidence = float(misfit[0] - misfit[best])
    if evidence < _MIN_DELAY_EVIDENCE or not 0 < best < len(_DELAYS) - 1:
        return 0.0, 0.0
    before, here, after = misfit[best - 1 : best + 2]
    step = _DELAYS[1] - _DELAYS[0]
    shift = 0.5 * (before - after) / max(before - 2.0 * here + after, 1e-12)
    return float(_DELAYS[best] + step * shift), evidence


def _load_factor(own: _JointRows, delay: int) -> tuple[float, float]:
    """Return the factor of weight and inertia in the error, and its deviation over stretches."""
    table, target = np.column_stack([own.load, own.columns]), own.errors[delay]
    factors, spread, _ = _least_squares(table, target, own.independent)
    parts = np.array_split(np.arange(len(target)), _STRETCHES)
    left_out = [
        _least_squares(np.delete(table, part, axis=0), np.delete(target, part), 1.0)[0][0]
        for part in parts
    ]
    jackknife = np.sqrt((_STRETCHES - 1) / _STRETCHES * np.sum((left_out - np.mean(left_out)) ** 2))
    return float(factors[0]), float(max(spread[0], jackknife))


def _least_squares(
    table: np.ndarray, target: np.ndarray, independent: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return factors, their standard deviations (k,) and the mean square of the residual.

    Filtered rows repeat one another: deviations count the independent ones.
    """
    size = np.linalg.norm(table, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    inverse = np.linalg.pinv(table / size)
    factors = inverse @ target
    left = target - (table / size) @ factors
    square = float(left @ left) / max(len(target) - len(factors), 1)
    spread = np.sqrt(square * np.sum(inverse**2, axis=1) * max(len(target) / independent, 1.0))
    return factors / size, spread / size, square
