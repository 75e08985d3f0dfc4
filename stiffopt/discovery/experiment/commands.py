"""Commands that move a position-controlled arm along a designed motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.recording.run import RecordedRun, command_interval
from stiffopt.result.trajectory import Trajectory


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
