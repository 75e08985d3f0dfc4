"""Changes that stay until a run ends: a payload that was picked up is no passing touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.judging.episodes import Episode, Track

# How near the end of a run counts as it [s], and the shortest that is a change [s].
_END, _SHORTEST = 0.5, 0.8
# Share of what is left in torques that a load at the last body explains, and how much less it must
# leave than constants.
_LOAD, _LESS = 0.7, 0.5
# Mass and its first moments, of the inertial parameters of a body.
_PARAMETERS = 4


def stays(
    episodes: Sequence[Episode], track: Track, robot: RobotModel, prepared: PreparedRun
) -> tuple[Episode, ...]:
    """The episodes of a run, those told that last until its end as a load does.

    Parameters
    ----------
    episodes : sequence of Episode
    track : Track
        What is left of the run.
    robot : RobotModel
    prepared : PreparedRun
        Its motion.
    """
    return tuple(
        replace(each, stays=True) if _is_load(each, track, robot, prepared) else each
        for each in episodes
    )


def _is_load(episode: Episode, track: Track, robot: RobotModel, prepared: PreparedRun) -> bool:
    if track.time[-1] - episode.end > _END or episode.end - episode.begin < _SHORTEST:
        return False
    time = track.time[(track.time >= episode.begin) & (track.time <= episode.end)]
    # A tenth of a second tells the motion that a load follows.
    time = time[:: max(1, len(time) // 200)]
    rows = np.searchsorted(track.time, time)
    places = np.clip(np.searchsorted(prepared.time, time), 0, len(prepared.time) - 1)
    signals = prepared.signals
    load = robot.body_torques(
        int(np.argmax(robot.order)),
        signals.motor_position[places],
        signals.motor_velocity[places],
        signals.motor_acceleration[places],
    )[:, :, :_PARAMETERS]
    left = track.left[rows, : robot.n]
    known = np.isfinite(left)
    if known.sum() < 10 * _PARAMETERS:
        return False
    # Both in N m, so that a joint with little noise does not decide alone.
    torque = (left * track.unit[: robot.n])[known]
    offsets = np.broadcast_to(np.eye(robot.n), (len(rows), robot.n, robot.n))[known]
    share = [_left(torque, columns) / float(torque @ torque) for columns in (load[known], offsets)]
    return share[0] < 1.0 - _LOAD and share[0] < _LESS * share[1]


def _left(values: np.ndarray, columns: np.ndarray) -> float:
    """Squares that a combination of columns leaves."""
    rest = values - columns @ np.linalg.lstsq(columns, values)[0]
    return float(rest @ rest)
