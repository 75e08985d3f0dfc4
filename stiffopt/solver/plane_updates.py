"""Separating planes: planes between solids are updated for the motion that was found.

The motion satisfies its new planes, so that the objective falls monotonically; couples of solids
that have come near elsewhere get rows.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from stiffopt.solver.clearance_rows import ClearanceRows
from stiffopt.solver.exchange import Oracle, Proposal, Rank
from stiffopt.solver.ipopt import RawSolution
from stiffopt.solver.programme import Programme, attach_solver, solve_stage
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import SolveStage

# Updates in the last and in earlier stages, and relative decrease of the objective below which they
# end.
_MAX_ROUNDS, _MAX_COARSE_ROUNDS = 12, 2
_MIN_RELATIVE_DECREASE = 2e-5
# Share to which an infeasible violation must fall for another update.
_MAX_REMAINING_VIOLATION = 0.7


@dataclass(frozen=True)
class StageEnd:
    """Programme of a stage with its solution."""

    made: Programme
    raw: RawSolution


class PlaneUpdates(Oracle[StageEnd]):
    """Planes of a stage, which starts from `x`."""

    step: ClassVar[str] = "separating planes"
    explores: ClassVar[bool] = False

    def __init__(
        self, run: SolveRun, rows: ClearanceRows, stage: SolveStage, x: np.ndarray, *, last: bool
    ) -> None:
        self._run, self._rows, self._stage, self._x = run, rows, stage, x
        self._before: RawSolution | None = None
        self._same = False
        self.rounds = _MAX_ROUNDS if last else _MAX_COARSE_ROUNDS

    def rank(self, found: StageEnd) -> Rank:
        """Return the rank by convergence: other rows may cost objective."""
        return (float(not found.raw.converged),)

    def restore(self, best: StageEnd) -> None:
        """Restore the bounds of the stage's programme."""
        best.made.solver.set_bounds(best.made.transcription.nlp)

    def propose(self, last: StageEnd, number: int) -> Proposal[StageEnd] | None:
        """Return a solve with planes of the last motion; None where these have settled."""
        raw = last.raw
        if raw.status == "time_limit" or self._has_converged(raw):
            return None
        begin = time.perf_counter()
        same, clear = False, not self._rows.collides_elsewhere(raw.x)
        if clear or not raw.converged:
            # Where the planes leave no feasible motion, those of the nearest one may.
            self._x = raw.x
            transcription, same = self._rows.update_planes(last.made.transcription, raw.x)
        else:
            # Restart from the collision-free point, with rows for the couples that collided.
            transcription = self._rows.rows_at(self._x)
        made = last.made
        if same:
            made.solver.set_bounds(transcription.nlp)
            made = Programme(transcription, made.solver)
        else:
            made = attach_solver(self._run, transcription)
        self._run.build_s += time.perf_counter() - begin
        self._before, self._same = raw, same
        warm = raw if same and raw.converged else None
        text = f"clear of collisions, round {number + 1}"
        return Proposal(
            "planes of this motion" if clear else "solids collide elsewhere",
            lambda: StageEnd(
                made, solve_stage(self._run, made, self._stage, self._x, warm, text, "adaptive")
            ),
        )

    def _has_converged(self, raw: RawSolution) -> bool:
        """Return True where the last update has changed nothing, or removed no infeasibility."""
        before = self._before
        if before is None:
            return False
        if not raw.converged:
            return raw.violation > _MAX_REMAINING_VIOLATION * before.violation
        fell = before.objective - raw.objective
        return (
            before.converged and self._same and fell <= _MIN_RELATIVE_DECREASE * abs(raw.objective)
        )
