"""States of a motion for an error budget: of a solve, or the quintic motion of a problem."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.baseline.baselines import quintic_motion
from stiffopt.budget.budget import ErrorModel
from stiffopt.budget.sources import States
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.uncertainty import Uncertainty, bounds_from_deviations
from stiffopt.errors import InputFileError
from stiffopt.files import load_json
from stiffopt.folders import check_result
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.recipe.stored_result import StoredResult

# Instants of a budget along a motion.
_INSTANT_COUNT = 121
_STIFFNESS_FILE = "stiffness.json"


def problem_states(problem: TrajectoryProblem) -> States:
    """Return the states of the quintic motion of a problem, at the least duration allowed."""
    motion = MotorMotion.of(quintic_motion(problem, resolve(problem)))
    return _sample_states(motion, motion, problem.servo)


def solved_states(stored: StoredResult) -> States:
    """Return the states of a solved motion; the servos follow its command, if there is one."""
    own = stored.optimised
    motion = MotorMotion(own.time, own.position, own.velocity)
    command = motion if stored.command is None else MotorMotion.of(stored.command.motors)
    return _sample_states(motion, command, stored.problem.servo)


def _sample_states(motion: MotorMotion, command: MotorMotion, servo: Servo) -> States:
    time = np.linspace(0.0, motion.duration, _INSTANT_COUNT)
    # Commands are sent ahead of the plan by the known dead time.
    followed = servo.follow(command, motion.duration, servo.dead_time)
    lag = followed.position(time) - motion.position(time)
    return States(
        time=time,
        position=motion(time),
        velocity=motion(time, 1),
        acceleration=motion(time, 2),
        lag=lag,
    )


def narrow_stiffness(model: ErrorModel, folder: Path) -> Uncertainty:
    """Return the uncertainty with the standard deviations of an identified stiffness.

    Parameters
    ----------
    model : ErrorModel
    folder : Path
        Of `stiffopt identify-stiffness`.

    Raises
    ------
    InputFileError
        The folder has no stiffness of this arm.
    """
    check_result(folder, _STIFFNESS_FILE)
    path = folder / _STIFFNESS_FILE
    document = load_json(path)
    known = np.full(model.robot.n, np.nan)
    try:
        joints = document["joints"]
        for number, joint in enumerate(joints):
            if joint["status"] == "identified":
                place = _joint_place(model, joint, number)
                known[place] = float(joint["sd"]) / float(joint["stiffness"])
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise InputFileError(
            path, "joints", f"has no usable {error}. Run identify-stiffness again."
        ) from error
    except IndexError as error:
        raise InputFileError(
            path, "joints", f"has {len(joints)} joints, {model.robot.name} has {model.robot.n}. "
            "Give the stiffness of the same arm."
        ) from error  # fmt: skip
    return bounds_from_deviations(model.uncertainty, known)


def _joint_place(model: ErrorModel, joint: dict[str, Any], number: int) -> int:
    """Index of a joint of the file: by name, else by number."""
    names = model.robot.joint_names
    if joint["name"] in names:
        return names.index(joint["name"])
    if number >= len(names):
        raise IndexError(number)
    return number
