"""Status of a solve, with exit code and sentence, and its progress for callbacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum


class SolveStatus(StrEnum):
    """Status of a solve; `usable` ones have a certified motion."""

    OPTIMAL = "optimal"
    ACCEPTABLE = "acceptable"
    INFEASIBLE = "infeasible"
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"
    INTERRUPTED = "interrupted"
    CERTIFICATE_FAILED = "certificate_failed"

    @property
    def usable(self) -> bool:
        """True if the motion is certified and may be run."""
        return self in (SolveStatus.OPTIMAL, SolveStatus.ACCEPTABLE)

    @property
    def exit_code(self) -> int:
        """Exit code of the command line: 0 usable, 130 interrupted, 3 otherwise."""
        if self.usable:
            return 0
        return 130 if self is SolveStatus.INTERRUPTED else 3

    @property
    def sentence(self) -> str:
        """Meaning and remedy."""
        return _STATUS_SENTENCES[self]


# The scope of the collision check is appended: `stiffopt.certificate.collisions.scope`.
_STATUS_SENTENCES = {
    SolveStatus.OPTIMAL: (
        "Solved and certified: every limit holds on the fine grid. Check the estimated inputs in "
        "the report before you rely on its numbers."
    ),
    SolveStatus.ACCEPTABLE: (
        "Solved to the looser tolerance and certified; the motion may be used. Raise "
        "method.intervals or method.time_limit for the full tolerance."
    ),
    SolveStatus.INFEASIBLE: (
        "No motion near the initial guess meets all limits; relax the rows named here, or give a "
        "longer duration."
    ),
    SolveStatus.ITERATION_LIMIT: (
        "The iteration limit came before the optimum; the best motion so far is kept. Raise "
        "method.max_iterations or start from fewer intervals."
    ),
    SolveStatus.TIME_LIMIT: (
        "The time limit came before the optimum; the best motion so far is kept. Raise "
        "method.time_limit or lower method.intervals."
    ),
    SolveStatus.INTERRUPTED: (
        "Stopped by the user; the best motion so far is kept. Run the same command to solve again."
    ),
    SolveStatus.CERTIFICATE_FAILED: (
        "The solver finished, but a limit is exceeded on the fine grid between nodes. Do not run "
        "this motion."
    ),
}


@dataclass(frozen=True)
class SolveProgress:
    """One iteration, for displays."""

    stage: str  # number of the stage, intervals and smoothing
    iteration: int
    objective: float  # in SI, of the smoothed model at the nodes
    violation: float  # worst row, relative to its scale
    row: str  # its name; empty without a violation
    elapsed: float  # since the solve began [s]


ProgressCallback = Callable[[SolveProgress], object]
