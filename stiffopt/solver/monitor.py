"""Monitoring of an IPOPT run: progress, time limit, Ctrl-C and the best iterate."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from stiffopt.transcription.nlp import Nlp

# Iterates with a smaller scaled violation count as feasible and are ranked by objective.
FEASIBLE_VIOLATION = 1e-6


@dataclass(frozen=True)
class Progress:
    """One iteration."""

    iteration: int
    objective: float  # in the problem's unit
    violation: float  # worst row, relative to its scale
    row: str  # name, label and place of that row; "" without a violation
    elapsed: float  # since the solve began [s]


@dataclass(frozen=True)
class Iterate:
    """Variables and rows of one iteration, scaled."""

    iteration: int
    x: np.ndarray
    g: np.ndarray
    objective: float
    violation: float

    def is_better_than(self, other: Iterate | None) -> bool:
        """Return True where this one has less violation or, both feasible, a lower objective."""
        if other is None:
            return True
        mine, theirs = (max(each.violation, FEASIBLE_VIOLATION) for each in (self, other))
        return (mine, self.objective) < (theirs, other.objective)


# Consecutive iterations within the tolerance that make an iterate stationary.
_STATIONARY_ITERATIONS = 5
# Step length from which a step counts as full.
_FULL_STEP_LENGTH = 1.0 - 1e-9
# Excess of a row, relative to its scale, that further iterations are likely to remove.
_NEARLY_FEASIBLE_VIOLATION = 1e-2


class Monitor(ca.Callback):
    """IPOPT's iteration callback; one object serves many solves one after another."""

    def __init__(self, nlp: Nlp) -> None:
        ca.Callback.__init__(self)
        self.nlp = nlp
        self._sizes = {
            "x": nlp.variables.size,
            "lam_x": nlp.variables.size,
            "f": 1,
            "g": nlp.rows.size,
            "lam_g": nlp.rows.size,
            "lam_p": nlp.p.numel(),
        }
        self.begin(None, float("inf"))
        self.construct("monitor", {})

    def begin(self, report: Callable[[Progress], object] | None, max_seconds: float) -> None:
        """Reset the record before a solve."""
        self.report, self.max_seconds, self.patience = report, max_seconds, 0
        self.max_iterations: int | None = None
        # Largest step of a stationary iterate, and the check after a few of them.
        self.still_step = 0.0
        self.has_ended: Callable[[], bool] = bool
        self.started = time.perf_counter()
        self.history: list[Progress] = []
        self.steps: list[float] = []  # largest change of a variable in each iteration
        self.best: Iterate | None = None
        self.last: Iterate | None = None
        # "interrupted", "time_limit", "iteration_limit", or "optimal" where only rounding is left.
        self.stopped_by = ""
        self.error: BaseException | None = None
        self.interrupt = threading.Event()

    def get_n_in(self) -> int:
        """Return the number of nlpsol outputs."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """Return one: the stop flag."""
        return 1

    def get_name_in(self, i: int) -> str:
        """Return the name of an nlpsol output."""
        return str(ca.nlpsol_out(i))

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of an nlpsol output."""
        return ca.Sparsity.dense(self._sizes.get(str(ca.nlpsol_out(i)), 0), 1)

    def has_eval_buffer(self) -> bool:
        """Return True: raw buffers take a tenth of the time of CasADi's matrices."""
        return True

    def eval_buffer(self, arg: Sequence[memoryview], res: Sequence[memoryview]) -> int:
        """Record one iteration; a result of 1 stops IPOPT."""
        np.frombuffer(res[0])[0] = self._evaluate_stop(arg)
        return 0

    def _evaluate_stop(self, arg: Sequence[memoryview]) -> float:
        try:
            self._record_iterate(arg)
        except BaseException as error:  # must not cross the C++ border; raised after the solve
            self.error = error
            return 1.0
        if self.interrupt.is_set():
            self.stopped_by = "interrupted"
        elif time.perf_counter() - self.started > self.max_seconds:
            self.stopped_by = "time_limit"
        elif self._has_spent_iterations():
            self.stopped_by = "iteration_limit"
        elif self._still_steps() >= _STATIONARY_ITERATIONS and self.has_ended():
            self.stopped_by = "optimal"
        return float(bool(self.stopped_by))

    def _still_steps(self) -> int:
        """Number of the last steps that are no longer than those of a stationary iterate."""
        moving = (k for k, step in enumerate(reversed(self.steps)) if not step <= self.still_step)
        return next(moving, len(self.steps))

    def is_stationary(self, lengths: Sequence[float]) -> bool:
        """Return True where the last iterates are feasible and stationary under full steps.

        Later steps that the line search shortened because of rounding do not matter as long as the
        iterates stay.

        `lengths` are the step lengths of all iterations, 1 for a full step.
        """
        still, tolerance = self._still_steps(), self.still_step
        full = [length >= _FULL_STEP_LENGTH for length in lengths[len(lengths) - still :]]
        if not any(
            all(full[k : k + _STATIONARY_ITERATIONS])
            for k in range(still - _STATIONARY_ITERATIONS + 1)
        ):
            return False
        since = self.history[-still:]
        objectives = [each.objective for each in since]
        largest = max(np.abs(objectives))
        return bool(
            np.ptp(objectives) <= tolerance * largest
            and max(each.violation for each in since) <= tolerance
        )

    def _has_spent_iterations(self) -> bool:
        """Return True at the iteration limit, or where patience ends without a feasible point."""
        made = len(self.history)
        if self.max_iterations is not None and made > self.max_iterations:
            return True
        near = self.best is not None and self.best.violation <= _NEARLY_FEASIBLE_VIOLATION
        return bool(self.patience) and made > self.patience and not near

    def _record_iterate(self, arg: Sequence[memoryview]) -> None:
        nlp = self.nlp
        # Copies: the buffers belong to IPOPT.
        x, g = (np.frombuffer(arg[k]).copy() for k in (0, 2))
        objective = float(np.frombuffer(arg[1])[0])
        violation, row = nlp.worst_excess(g)
        number = len(self.history)
        if self.last is not None:
            self.steps.append(float(np.abs(x - self.last.x).max(initial=0.0)))
        self.last = Iterate(number, x, g, objective, violation)
        if np.isfinite([objective, violation]).all() and self.last.is_better_than(self.best):
            self.best = self.last
        elapsed = time.perf_counter() - self.started
        progress = Progress(number, objective, violation, row, elapsed)
        self.history.append(progress)
        if self.report is not None:
            self.report(progress)
