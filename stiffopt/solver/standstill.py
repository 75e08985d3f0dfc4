"""Joints that creep are brought to rest, where dry friction is what it is said to be.

Dry friction changes its sign within a small speed, so that the optimiser has a solution. Within it
a joint has less friction than it truly has, and so the least squared torque lets joints creep that
would better stand still: truly they are charged for all of their friction. No mesh and no narrower
width changes that, as the speed falls with the width. At rest both laws agree.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.dynamics.friction import smoothing_width
from stiffopt.problem.coordinates import coordinates_of
from stiffopt.problem.prediction import predict_motion
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.trajectory import Trajectory
from stiffopt.transcription.transcription import Transcription

# Of the width of the friction's change of sign: what moves no faster creeps.
_SLOW = 0.5
# Nodes in a row at which a joint creeps, and share of the motion; less is where it turns.
_LEAST, _SHORTEST = 3, 0.02


def at_rest(
    transcription: Transcription, x: np.ndarray, problem: TrajectoryProblem
) -> Transcription | None:
    """The transcription with bounds that keep joints at rest where they creep.

    Parameters
    ----------
    transcription : Transcription
    x : array
        The NLP vector in which joints creep.
    problem : TrajectoryProblem

    Returns
    -------
    Transcription or None
        None where no joint with dry friction creeps, or joints are not planned one by one.
    """
    coordinates, robot = coordinates_of(problem), problem.robot
    n = coordinates.size
    if coordinates.order != 2 or not coordinates.bounds_joints:
        return None
    nlp, states, controls = transcription.nlp, transcription.states, transcription.controls
    assert states.places is not None
    assert controls.places is not None
    width = _SLOW * np.asarray(smoothing_width(robot.velocity_max))
    slow = np.abs(transcription.node_states(x)[:, n:]) < width
    times = transcription.times_of(states.places, x)
    driven = transcription.times_of(controls.places, x)
    least = _SHORTEST * float(transcription.phase_durations(x).sum())
    still = np.zeros(nlp.variables.size, dtype=bool)
    for j in np.flatnonzero(np.asarray(robot.coulomb) > 0.0):
        for run in _runs(slow[:, j]):
            first, last = times[run[0]], times[run[-1]]
            if len(run) < _LEAST or last - first < least:
                continue
            # What follows from it is left to the equations of motion: said twice, they depend.
            still[states.offset + run[0] * 2 * n + n + j] = True
            held = np.flatnonzero((driven >= first) & (driven <= last))
            still[controls.offset + held * n + j] = True
    # Given velocities stay.
    still &= (nlp.lower_x <= 0.0) & (nlp.upper_x >= 0.0)
    if not np.any(still):
        return None
    lower, upper = np.where(still, 0.0, nlp.lower_x), np.where(still, 0.0, nlp.upper_x)
    return replace(transcription, nlp=replace(nlp, lower_x=lower, upper_x=upper))


def lacking_friction(problem: TrajectoryProblem, motion: Trajectory, smoothing: Smoothing) -> float:
    """What smooth dry friction lacks of the squared torque ratios at the optimiser's own instants.

    Relative to the true ones; 0 where no torque is minimised.
    """
    if not any(objective.kind.of_drives for objective in problem.objectives):
        return 0.0
    believed = predict_motion(problem, motion, smoothing, elastic=False)
    if believed.torque is None:
        return 0.0
    true = assess(problem, motion, times=believed.time).torque
    size = problem.robot.torque_max
    sums = [
        np.trapezoid(((torque / size) ** 2).sum(axis=1), believed.time)
        for torque in (believed.torque, true)
    ]
    return float(1.0 - sums[0] / sums[1]) if sums[1] > 0.0 else 0.0


def _runs(where: np.ndarray) -> list[np.ndarray]:
    """Indices of what is true, in runs without a gap."""
    index = np.flatnonzero(where)
    return np.split(index, np.flatnonzero(np.diff(index) > 1) + 1) if index.size else []
