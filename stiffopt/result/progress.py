"""Progress of a solve, as its callbacks get it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


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
