"""States of a motion for an error budget: of a solve, or the quintic motion of a problem."""

from __future__ import annotations

import numpy as np

from stiffopt.baseline.baselines import quintic_motion
from stiffopt.budget.sources import States
from stiffopt.elastic.motor import MotorMotion
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.recipe.stored_result import StoredResult

# Instants of a budget along a motion.
_INSTANT_COUNT = 121


def problem_states(problem: TrajectoryProblem) -> States:
    """Return the states of the quintic motion of a problem, at the least duration allowed."""
    motion = MotorMotion.of(quintic_motion(problem, resolve(problem)))
    return _sample_states(motion, motion, problem)


def solved_states(stored: StoredResult) -> States:
    """Return the states of a solved motion; the servos follow its command, if there is one."""
    own = stored.optimised
    motion = MotorMotion(own.time, own.position, own.velocity)
    command = motion if stored.command is None else MotorMotion.of(stored.command.motors)
    return _sample_states(motion, command, stored.problem)


def _sample_states(motion: MotorMotion, command: MotorMotion, problem: TrajectoryProblem) -> States:
    time = np.linspace(0.0, motion.duration, _INSTANT_COUNT)
    # Commands are sent ahead of the plan by the known dead time.
    followed = problem.servo.follow(command, motion.duration, problem.led_servo.dead_time)
    lag = followed.position(time) - motion.position(time)
    return States(
        time=time,
        position=motion(time),
        velocity=motion(time, 1),
        acceleration=motion(time, 2),
        lag=lag,
    )
