"""Motions of an experiment: limits, Fourier series, and commands that move an arm so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun, prepare_run
from stiffopt.discovery.training import Training
from stiffopt.recording.run import RecordedRun, command_interval
from stiffopt.result.trajectory import Trajectory

# Used share of the limits, so that they hold on the real arm.
_LIMIT_USE = 0.95
# Extension of the recorded stroke of a joint, as share of it.
_RANGE_EXTENSION = 0.25
_HARMONIC_COUNT = 4
# Base frequency, stroke and centre; sine and cosine of each harmonic.
DRAWS_PER_JOINT = 3 + 2 * _HARMONIC_COUNT
_MAX_BASE_FREQUENCY = 0.6  # [Hz]
_KNOT_SPACING = 0.1  # [s]
# Share of the duration for acceleration from rest, and for stopping.
_RAMP_SHARE = 0.12
_SHRINK_FACTOR = 0.8
_SAMPLE_TIME = 0.01  # [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionLimits:
    """Limits of a designed motion, (n,) each."""

    # lower, upper [rad]
    lower: np.ndarray
    upper: np.ndarray
    # velocity, acceleration, torque: magnitudes [rad/s], [rad/s^2], [N m].
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray

    def excess(self, robot: RobotModel, motion: Trajectory) -> float:
        """Return the largest value over its limit along a motion; 1 is the limit."""
        times = motion.sample(_SAMPLE_TIME)
        q, v, a = (motion(times, order) for order in range(3))
        middle, half = 0.5 * (self.lower + self.upper), 0.5 * (self.upper - self.lower)
        torque = robot.rotor_inertia * a + robot.spring_torque(q, v, a) + robot.friction(v)
        used = (
            np.abs(q - middle) / half,
            np.abs(v) / self.velocity,
            np.abs(a) / self.acceleration,
            np.abs(torque) / self.torque,
        )
        return float(max(u.max() for u in used))


def motion_limits(training: Training) -> MotionLimits:
    """Return limits of the arm; where it states none, the extremes of the training runs."""
    robot, constants = training.robot, training.constants
    arm, order = robot.arm, robot.order
    met = np.array([j.stroke for j in constants.joints])
    wider = _RANGE_EXTENSION * (met[:, 1] - met[:, 0]) + 0.05
    # Obstacles beyond the recorded strokes are unknown.
    lower = np.maximum(arm.position_lower[order], met[:, 0] - wider)
    upper = np.minimum(arm.position_upper[order], met[:, 1] + wider)
    middle, half = 0.5 * (lower + upper), 0.5 * _LIMIT_USE * (upper - lower)
    own = arm.velocity_max[order]
    fastest = np.array([j.fastest for j in constants.joints])
    velocity = np.where((own > 0.0) & np.isfinite(own), own, fastest)
    # Filtered: jumps at friction reversals are no demand on the drives.
    asked = [run.low_pass(run.signals.motor_acceleration) for run in training.runs]
    hardest = np.max([np.abs(each).max(axis=0) for each in asked], axis=0)
    return MotionLimits(
        lower=middle - half,
        upper=middle + half,
        velocity=_LIMIT_USE * velocity,
        acceleration=_LIMIT_USE * np.maximum(hardest, 1e-3),
        torque=_LIMIT_USE * np.array([j.torque_max for j in constants.joints]),
    )


def fourier_motion(
    limits: MotionLimits, robot: RobotModel, duration: float, draws: np.ndarray
) -> Trajectory | None:
    """Return a Fourier series in every joint, from rest to rest, scaled to the limits.

    `duration` [s]. `draws` (n, DRAWS_PER_JOINT): standard normal draws: of base frequency, stroke
    and centre, then of the harmonics. None if even a small motion about the drawn pose exceeds
    them.
    """
    from scipy.interpolate import CubicSpline

    n = robot.n
    knots = np.linspace(0.0, duration, int(np.ceil(duration / _KNOT_SPACING)) + 1)
    share = ndtr(draws[:, :3])
    # From once in the whole motion to often: separation may need slow or fast motion.
    slowest = _MAX_BASE_FREQUENCY ** share[:, 0] * duration ** (share[:, 0] - 1.0)
    order = np.arange(1, _HARMONIC_COUNT + 1)
    weights = draws[:, 3:].reshape(n, _HARMONIC_COUNT, 2) / order[:, None]
    phase = 2.0 * np.pi * slowest[:, None, None] * order[:, None] * knots
    wave = (weights[..., :1] * np.sin(phase) + weights[..., 1:] * np.cos(phase)).sum(axis=1).T
    ramp = np.clip(np.minimum(knots, duration - knots) / (_RAMP_SHARE * duration), 0.0, 1.0)
    wave *= (ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2))[:, None]
    wave /= np.maximum(np.abs(wave).max(axis=0), 1e-9)
    half = 0.5 * (limits.upper - limits.lower)
    size = half * (0.2 + 0.75 * share[:, 1])
    centre = 0.5 * (limits.lower + limits.upper) + (half - size) * (1.8 * share[:, 2] - 0.9)
    spline = CubicSpline(knots, wave, bc_type="clamped")
    fine = np.arange(0.0, duration, _SAMPLE_TIME)
    size = np.minimum(size, 0.99 * limits.velocity / np.abs(spline(fine, 1)).max(axis=0))
    size = np.minimum(size, 0.99 * limits.acceleration / np.abs(spline(knots, 2)).max(axis=0))
    for _ in range(12):
        motion = Trajectory.piecewise_linear_acceleration(
            knots, size * spline(knots, 2), centre + size * spline(0.0), np.zeros(n)
        )
        if limits.excess(robot, motion) <= 1.0:
            return motion
        size = _SHRINK_FACTOR * size
    return None


def prepared_motion(training: Training, motion: Trajectory) -> PreparedRun:
    """Prepare a motion as a run with all channels of the training runs."""
    times = np.arange(0.0, motion.duration, _SAMPLE_TIME)
    position = motion(times)
    like = training.recorded[0]
    has_torque = np.any([np.isfinite(r.torque).any(axis=0) for r in training.recorded], axis=0)
    link = None
    if any(r.link_position is not None for r in training.recorded):
        seen = np.any(
            [
                np.isfinite(r.link_position).any(axis=0)
                for r in training.recorded
                if r.link_position is not None
            ],
            axis=0,
        )
        link = np.where(seen, position, np.nan)
    run = RecordedRun(
        name="next_experiment",
        file="",
        role="train",
        session_time=like.session_time,
        number=like.number,
        temperature=like.temperature,
        stamps=times,
        time=times,
        position=position,
        velocity=None,
        link_position=link,
        torque=np.where(has_torque, np.zeros_like(position), np.nan),
        faults=(),
    )
    return prepare_run(
        training.robot, run, 0, training.constants, training.settings, vibrating=False
    )


@dataclass(frozen=True, eq=False)
class SentCommands:
    """Commands (K, n) [rad], each held until the next, and when they are sent (K,) [s]."""

    time: np.ndarray
    position: np.ndarray


def motion_commands(
    robot: RobotModel, runs: Sequence[RecordedRun], motion: Trajectory
) -> SentCommands | None:
    """Return commands for a motion as often as those of some runs, within the joints' limits.

    The law of the actuators is solved for the command at the nominal torque of the motion, ahead
    by the delay and by half an interval, for which a held command is late on average. None for
    arms that are not commanded or whose actuators are not known.
    """
    law, commanded = robot.recordings.actuator, [run for run in runs if run.command is not None]
    if law is None or not law.known or not commanded:
        return None
    interval = float(np.nanmedian([command_interval(run) for run in commanded]))
    times = np.arange(0.0, motion.duration, interval)
    ahead = np.minimum(times + law.delay + 0.5 * interval, motion.duration)
    q, v, a = (motion(ahead, order) for order in range(3))
    torque = robot.rotor_inertia * a + robot.spring_torque(q, v, a) + robot.friction(v)
    command = q + (torque + law.damping * v) / law.stiffness
    lower, upper = (x[robot.order] for x in (robot.arm.position_lower, robot.arm.position_upper))
    return SentCommands(times, np.clip(command, lower, upper))
