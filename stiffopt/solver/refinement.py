"""Refinement of a motion that fails its certificate: finer mesh, joints at rest, back-off.

A rigid plan (motors and links move alike) is solved on finer meshes, then with backed-off limits. A
motion planned for the links keeps its mesh.
"""

from __future__ import annotations

import numpy as np

from stiffopt.solver.arrival import refine_within_mesh
from stiffopt.solver.exact_rows import ExactRows, describe_excess, excess_by_limit
from stiffopt.solver.exchange import OutcomeOracle, Proposal, exchange
from stiffopt.solver.programme import Outcome
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import MANY_PHASES, SolveStage, finer_mesh
from stiffopt.solver.stages import run_stages
from stiffopt.solver.stationary_joints import StationaryJoints
from stiffopt.solver.verdict import MAX_OBJECTIVE_GAP
from stiffopt.transcription.constraint_back_off import backed_off

_MAX_FINER_MESHES = 3
_MESH_GROWTH = 1.25


def refine(run: SolveRun, outcome: Outcome) -> Outcome:
    """Refine an outcome until its certificate passes."""
    if run.problem.plans_links:
        return refine_within_mesh(run, outcome)
    outcome = exchange(run, StationaryJoints(run, outcome), outcome)
    if outcome.transcription.ocp.phases >= MANY_PHASES:
        # A finer mesh takes as long as all solves before it, a correction a tenth of that.
        outcome = exchange(run, ExactRows(run), outcome)
    outcome = exchange(run, MeshError(run), outcome)
    return exchange(run, ExactRows(run), outcome)


class MeshError(OutcomeOracle):
    """Mesh error: meshes that are short where the controls change; later ones with back-off."""

    step = "finer meshes"

    def __init__(self, run: SolveRun) -> None:
        super().__init__(run)
        # All limits of a fixed path are path rows, which are backed off only where exceeded.
        self.rounds = _MAX_FINER_MESHES if run.problem.path is None else 1
        self._margins: dict[str, float] = {}

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return a solve on a finer mesh; None where limits and objective gap hold."""
        run, excess, before = self.run, excess_by_limit(last.assessment), last.transcription
        if not last.raw.converged or not (excess or last.objective_gap > MAX_OBJECTIVE_GAP):
            return None
        for name, value in excess.items() if number else ():
            self._margins[name] = backed_off(self._margins.get(name, 0.0), value)
        intervals = int(np.ceil(len(before.intervals) * _MESH_GROWTH))
        stage = SolveStage(intervals, last.smoothing)
        guess = before.guess_from(last.raw.x)
        mesh = finer_mesh(run.problem, before, last.raw.x, intervals)

        def solve() -> Outcome:
            finer = run_stages(run, (stage,), guess, self._margins, mesh)
            return finer if finer.failed else exchange(run, StationaryJoints(run, finer), finer)

        gap = f"objective {last.objective_gap:.1%} worse between the nodes"
        return Proposal(describe_excess(excess) or gap, solve)
