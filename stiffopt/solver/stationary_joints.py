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

from stiffopt.dynamics.friction import dry_friction_width
from stiffopt.problem.coordinates import coordinates_of
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.solver.exchange import OutcomeOracle, Proposal
from stiffopt.solver.programme import Outcome, solve_again
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import MANY_PHASES
from stiffopt.transcription.transcription import Transcription

# Speed below which a joint creeps, as a share of the friction's smoothing width.
_CREEP_SPEED_SHARE = 0.5
# Consecutive nodes and share of the motion for which a joint must creep; a reversal is shorter.
_MIN_CREEP_NODES, _MIN_CREEP_SHARE = 3, 0.02
# Intervals that a motion from rest to rest takes at least: in fewer it has no freedom left.
_MIN_MOVING_INTERVALS = 3
# Solves with creeping joints fixed, and iterations of the one before them that finds these.
_MAX_STATIONARY_SOLVES, _MAX_CREEPING_ITERATIONS = 2, 60


class StationaryJoints(OutcomeOracle):
    """Joints that had better rest: first they may creep where that costs less than moving."""

    step = "joints at rest"

    def __init__(self, run: SolveRun, start: Outcome) -> None:
        super().__init__(run)
        self._free = start.transcription
        # With many phases, some of the many fixed joints are in conflict.
        few = self._free.ocp.phases < MANY_PHASES
        self.rounds = 1 + _MAX_STATIONARY_SOLVES if run.problem.charges_dry_friction and few else 0

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return a solve in which joints may creep, then those with these fixed; None without."""
        smoothing = replace(last.smoothing, creeping=1.0)
        if number == 0:
            limit = _MAX_CREEPING_ITERATIONS
            return Proposal(
                "joints may creep",
                lambda: solve_again(self.run, last, self._free.nlp, smoothing, limit),
            )
        # A motion that still changes shows where joints creep as well.
        fixed = fix_creeping_joints(self._free, last.raw.x, self.run.problem)
        if fixed is None or not (last.raw.converged or number == 1):
            return None
        before = replace(last, transcription=fixed)
        return Proposal("joints creep", lambda: solve_again(self.run, before, fixed.nlp, smoothing))


def fix_creeping_joints(
    transcription: Transcription, x: np.ndarray, problem: TrajectoryProblem
) -> Transcription | None:
    """Return the transcription with bounds that fix joints where they creep.

    Joints creep in the NLP vector `x`. None where no joint with dry friction does, or the states
    are not joint positions.
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


def _index_runs(where: np.ndarray, gap: int) -> list[np.ndarray]:
    """Return the indices of true entries, split where at least `gap` intervals lie between two."""
    index = np.flatnonzero(where)
    return np.split(index, np.flatnonzero(np.diff(index) >= gap) + 1) if index.size else []
