"""Stationary joints: creeping joints are fixed, where the smoothed dry friction is exact.

A joint at rest has no dry friction, a moving one has all of it: the exact law jumps. Where the
optimiser charges friction in full at any speed, it finds no joint that had better rest; where it
charges the smooth law, joints creep within its width, and the certificate charges the full
friction. Neither a finer mesh nor a narrower width changes that, as the speed falls with the width.
So joints creep first and are then fixed: at rest both laws agree.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.dynamics.friction import dry_friction_width
from stiffopt.problem.coordinates import coordinates_of
from stiffopt.problem.prediction import predict_motion
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.trajectory import Trajectory
from stiffopt.transcription.transcription import Transcription

# Speed below which a joint creeps, as a share of the friction's smoothing width.
_CREEP_SPEED_SHARE = 0.5
# Consecutive nodes and share of the motion for which a joint must creep; a reversal is shorter.
_MIN_CREEP_NODES, _MIN_CREEP_SHARE = 3, 0.02
# Intervals that a motion from rest to rest takes at least: in fewer it has no freedom left.
_MIN_MOVING_INTERVALS = 3


def fix_creeping_joints(
    transcription: Transcription, x: np.ndarray, problem: TrajectoryProblem
) -> Transcription | None:
    """Return the transcription with bounds that fix joints where they creep.

    Parameters
    ----------
    transcription : Transcription
    x : array
        The NLP vector in which joints creep.
    problem : TrajectoryProblem

    Returns
    -------
    Transcription or None
        None where no joint with dry friction creeps, or the states are not joint positions.
    """
    coordinates, robot = coordinates_of(problem), problem.robot
    n = coordinates.size
    if coordinates.order != 2 or not coordinates.bounds_joints:
        return None
    nlp, states, controls = transcription.nlp, transcription.states, transcription.controls
    assert states.places is not None
    assert controls.places is not None
    width = _CREEP_SPEED_SHARE * np.asarray(dry_friction_width(robot.velocity_max))
    slow = np.abs(transcription.node_states(x)[:, n:]) < width
    times = transcription.times_of(states.places, x)
    driven = transcription.times_of(controls.places, x)
    least = _MIN_CREEP_SHARE * float(transcription.phase_durations(x).sum())
    still = np.zeros(nlp.variables.size, dtype=bool)
    for j in np.flatnonzero(np.asarray(robot.coulomb) > 0.0):
        for run in _index_runs(slow[:, j], gap=_MIN_MOVING_INTERVALS):
            first, last = times[run[0]], times[run[-1]]
            if len(run) < _MIN_CREEP_NODES or last - first < least:
                continue
            # Only velocity and control: further bounds would be linearly dependent on the dynamics.
            still[states.offset + run[0] * 2 * n + n + j] = True
            held = np.flatnonzero((driven >= first) & (driven <= last))
            still[controls.offset + held * n + j] = True
    # Given nonzero velocities are not changed.
    still &= (nlp.lower_x <= 0.0) & (nlp.upper_x >= 0.0)
    if not np.any(still):
        return None
    lower, upper = np.where(still, 0.0, nlp.lower_x), np.where(still, 0.0, nlp.upper_x)
    return replace(transcription, nlp=replace(nlp, lower_x=lower, upper_x=upper))


def missing_friction_share(
    problem: TrajectoryProblem, motion: Trajectory, smoothing: Smoothing
) -> float:
    """Return the share of squared torque that smoothed dry friction misses at the nodes.

    Relative to the exact one; 0 where no torque is minimised.
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


def _index_runs(where: np.ndarray, gap: int) -> list[np.ndarray]:
    """Return the indices of true entries, split where at least `gap` intervals lie between two."""
    index = np.flatnonzero(where)
    return np.split(index, np.flatnonzero(np.diff(index) >= gap) + 1) if index.size else []
