"""Excitation of each joint in a set of runs: speeds, directions, loads, temperatures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.recording.channel_faults import moved_travel
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun

# Speed up to which a joint is at rest, and up to which it is slow [rad/s].
_MAX_REST_SPEED = 0.005
# Shares of the samples from which a condition counts as recorded, common and rare ones.
_MIN_COMMON_SHARE, _MIN_RARE_SHARE = 0.05, 0.01


@dataclass(frozen=True, kw_only=True)
class JointFacts:
    """Excitation of one joint in the runs."""

    # Torque or link encoder is recorded.
    torque: bool
    link: bool
    # Its wind-up is observable: by a link encoder, or in the torque through the elastic model.
    windup: bool
    # It moves; in both directions; between 0.005 and 0.1 rad/s; over a range of speeds of two to
    # one; it is at rest for a time.
    moves: bool
    reverses: bool
    slow: bool
    speeds: bool
    rests: bool
    # Its load changes sign, by gravity or with inertia, or gravity hardly loads it.
    load_changes_sign: bool
    rotor_slow: bool  # part of the motion is slow enough to resolve two periods a turn of the rotor
    ripple_slow: bool  # the same for the periods of the motor's poles
    warmer: bool  # runs differ in temperature by 3 K or in session time by 120 s
    at_rest: bool = False  # all runs are poses at rest

    @property
    def sensor(self) -> bool:
        """Return whether a torque or a link encoder is recorded; named by `Need`."""
        return self.torque or self.link

    @property
    def balances(self) -> tuple[str, ...]:
        """Equations that can be evaluated for the joint."""
        if not self.torque:
            return ("deflection",) if self.link else ()
        return ("motor", "link", "deflection") if self.link else ("torque",)


def joint_facts(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> tuple[JointFacts, ...]:
    """Excitation of every joint in some runs, in the order of the set."""
    gravity = [_gravity_torques(recordings, run) for run in runs if run.usable]
    loads = [_inertial_loads(recordings, run) for run in runs if run.usable]
    return tuple(_joint_facts(recordings, runs, gravity, loads, j) for j in range(recordings.n))


def velocities(run: RecordedRun) -> np.ndarray:
    """Recorded velocity, else the slope of the encoder over 20 ms, (K, n) [rad/s]."""
    if run.at_rest:
        return np.zeros_like(run.position)
    width = max(1, round(0.01 / run.step))
    slope: np.ndarray = np.full_like(run.position, np.nan)
    span = run.time[2 * width :] - run.time[: -2 * width]
    slope[width:-width] = (run.position[2 * width :] - run.position[: -2 * width]) / span[:, None]
    if run.velocity is not None:
        recorded = np.isfinite(run.velocity).any(axis=0)
        slope[:, recorded] = run.velocity[:, recorded]
    return slope


def _gravity_torques(recordings: RecordingSet, run: RecordedRun) -> np.ndarray:
    """Gravity torque of the nominal model at some samples, (m, n) [N m]."""
    order = recordings.order
    # Gravity changes slowly: one sample of so many suffices.
    rows = run.position[:: 1 if run.at_rest else 20]
    rows = rows[np.isfinite(rows).all(axis=1)]
    position = np.zeros(rows.shape)
    position[:, order] = rows
    return recordings.robot.bodies_in_motion().gravity_torque(position)[:, order]


def _inertial_loads(recordings: RecordingSet, run: RecordedRun) -> np.ndarray:
    """Torque of weight and inertia of the nominal model at some samples, (m, n) [N m]."""
    if run.at_rest:
        return _gravity_torques(recordings, run)
    order, speed = recordings.order, velocities(run)
    # Half the window of accelerations from speeds [s].
    width = max(1, round(0.025 / run.step))
    middle = np.arange(width, len(run.time) - width, width)
    span = (run.time[middle + width] - run.time[middle - width])[:, None]
    rate = (speed[middle + width] - speed[middle - width]) / span
    motion = np.stack([run.position[middle], speed[middle], rate])
    motion = motion[:, np.isfinite(motion).all(axis=(0, 2))]
    placed = np.zeros(motion.shape)
    placed[:, :, order] = motion
    return recordings.robot.bodies_in_motion().torque(*placed)[:, order]


def _changes_sign(load: np.ndarray) -> bool:
    """Return whether a load changes sign."""
    # Less load of the other sign is encoder noise near zero, no change of sign.
    least = 0.02 * np.abs(load).max(initial=0.0)
    return bool(load.min(initial=0.0) < -least and load.max(initial=0.0) > least)


def _joint_facts(
    recordings: RecordingSet,
    runs: Sequence[RecordedRun],
    gravity: Sequence[np.ndarray],
    loads: Sequence[np.ndarray],
    j: int,
) -> JointFacts:
    torque = _finite_values([run.torque[:, j] for run in runs])
    links = [run.link_position[:, j] for run in runs if run.link_position is not None]
    velocity = np.concatenate([np.zeros(0), *(velocities(run)[:, j] for run in runs)])
    velocity = velocity[np.isfinite(velocity)]
    speed = np.abs(velocity)
    moving = speed > _MAX_REST_SPEED
    travel = [np.ptp(run.position[:, j]) for run in runs if np.isfinite(run.position[:, j]).all()]
    least = moved_travel(recordings.prismatic[j])
    moves = bool(moving.any() and (not travel or max(travel) > least))
    count = max(1, int(moving.sum()))
    quick, usual = np.quantile(speed[moving], (0.95, 0.1)) if moving.any() else (0.0, 1.0)
    weight = np.concatenate([np.zeros(0), *(g[:, j] for g in gravity)])
    largest = float(np.abs(torque).max(initial=0.0))
    light = np.abs(weight).max(initial=0.0) < 0.3 * largest
    poles = recordings.nominal.pole_pairs
    link = len(_finite_values(links)) > 0
    return JointFacts(
        torque=len(torque) > 0,
        link=link,
        windup=link or (len(torque) > 0 and recordings.swings),
        moves=moves,
        reverses=moves
        and min((velocity > _MAX_REST_SPEED).sum(), (velocity < -_MAX_REST_SPEED).sum())
        > _MIN_COMMON_SHARE * count,
        slow=moves and ((speed > _MAX_REST_SPEED) & (speed < 0.1)).sum() > _MIN_RARE_SHARE * count,
        speeds=moves and bool(quick > 2.0 * usual),
        rests=bool((~moving).sum() > _MIN_RARE_SHARE * max(1, len(speed))),
        load_changes_sign=moves
        and bool(
            light
            or weight.min(initial=0.0) < 0.0 < weight.max(initial=0.0)
            or _changes_sign(np.concatenate([np.zeros(0), *(load[:, j] for load in loads)]))
        ),
        rotor_slow=moves and _resolves_periods(recordings, runs, speed[moving], j, 2.0),
        ripple_slow=moves and _resolves_periods(recordings, runs, speed[moving], j, poles or 1.0),
        warmer=_differs_in_temperature(runs, j),
        at_rest=bool(runs) and all(run.at_rest for run in runs),
    )


def _finite_values(channels: Sequence[np.ndarray]) -> np.ndarray:
    values = np.concatenate([np.zeros(0), *channels])
    finite: np.ndarray = values[np.isfinite(values)]
    return finite


def _resolves_periods(
    recordings: RecordingSet, runs: Sequence[RecordedRun], speed: np.ndarray, j: int, order: float
) -> bool:
    ratio = recordings.nominal.gear_ratio
    if ratio is None or not len(speed):
        return False
    rate = 1.0 / max(run.step for run in runs)
    frequency = order * abs(ratio[j]) * speed / (2.0 * np.pi)
    # Of the Nyquist frequency; periodic torque above it is not resolved.
    return bool((frequency < 0.5 * 0.8 * rate).mean() > _MIN_COMMON_SHARE)


def _differs_in_temperature(runs: Sequence[RecordedRun], j: int) -> bool:
    degrees = [float(run.temperature[j]) for run in runs if run.temperature is not None]
    times = [run.session_time for run in runs if run.session_time is not None]
    return (bool(degrees) and max(degrees) - min(degrees) >= 3.0) or (
        bool(times) and max(times) - min(times) >= 120.0
    )
